"""Functions under the names of bsk_rl's utilities give bsk_rl 1.3.8's numbers (recorded from it), also for batches."""

import math

import numpy as np
import pytest
import torch

from bsk_torch.astro import relative

R, V = np.array([-2438.5e3, 5811.1e3, 3011.7e3]), np.array([-5543.2, -4210.9, 3605.4])
DEPUTY = R + np.array([120.0, -340.0, 95.0]), V + np.array([0.12, -0.3, 0.05])
PLACE = np.array([-2000e3, 5200e3, 3000e3])
RHO = np.array([100.0, -200.0, 50.0]), np.array([0.1, 0.2, -0.3])

HN = [
    [-0.349122122530613, 0.8319801378870803, 0.4311876548802326],
    [-0.7076900025640921, -0.5357044852612556, 0.46064689811373777],
    [0.6142382305185463, -0.14432516978118548, 0.7758103128581606],
]
FIBONACCI = [
    [0.5150787536377126, 0.0, -0.8571428571428572],
    [-0.6051231019611957, 0.5543423303591045, -0.5714285714285714],
    [0.08378137004970251, -0.9546454991102039, -0.2857142857142857],
]
RECORDED = {
    "elevation": (relative.elevation, (R, PLACE), [1.0337329852026467]),
    "lla2ecef": (relative.lla2ecef, (40.015, -105.27, 6378136.6), [[-1286516.3628599744, -4712404.733610201, 4101066.173935903]]),
    "rv2HN": (relative.rv2HN, (R, V), [HN]),
    "rv2omega": (relative.rv2omega, (R, V), [[0.00068941193284648, -0.0001619884424537446, 0.000870758055646013]]),
    "cd2hill": (
        relative.cd2hill,
        (R, V, *DEPUTY),
        [
            [-283.8050743716587, 140.97818000194096, 196.48112510935388],
            [-0.11169748284814668, 0.41735952087864253, 0.15579665423958955],
        ],
    ),
    "hill2cd": (
        relative.hill2cd,
        (R, V, *RHO),
        [
            [-2438362.662300214, 5811283.122652352, 3011689.7799015082],
            [-5543.718521668791, -4210.754011566041, 3605.4509991130376],
        ],
    ),
}


def results(value):
    return list(value) if isinstance(value, tuple) else [value]


@pytest.mark.parametrize("name", RECORDED)
def test_numbers_are_those_of_bsk_rl(name):
    function, given, expected = RECORDED[name]
    found = results(function(*given))
    assert len(found) == len(expected) > 0
    for got, value in zip(found, expected, strict=True):
        assert isinstance(got, np.ndarray | float)
        np.testing.assert_allclose(got, value, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", RECORDED)
def test_batches_of_tensors_give_the_same_rows(name):
    function, given, expected = RECORDED[name]
    batch = [torch.as_tensor(np.asarray(value), dtype=torch.float64).expand(4, *np.shape(value)) for value in given]
    found = results(function(*batch))
    assert len(found) == len(expected) > 0
    for got, value in zip(found, expected, strict=True):
        assert isinstance(got, torch.Tensor)
        torch.testing.assert_close(
            got, torch.tensor(value, dtype=torch.float64).expand(4, *np.shape(value)), rtol=1e-12, atol=1e-9
        )


def test_there_and_back():
    back = relative.cd2hill(R, V, *relative.hill2cd(R, V, *RHO))
    np.testing.assert_allclose(back[0], RHO[0], atol=1e-8)
    np.testing.assert_allclose(back[1], RHO[1], atol=1e-11)
    points = relative.fibonacci_sphere(7)
    np.testing.assert_allclose(points[:3], FIBONACCI, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0)
    assert math.isnan(relative.rv2omega([0.0, 0.0, 0.0], V)[0])
