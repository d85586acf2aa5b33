import pytest
import torch

from bsk_torch.vec3 import Mat3, Vec3, select

ROUNDING = 1e-14  # a handful of float64 operations on numbers of order one


def vectors(*shape: int) -> tuple[torch.Tensor, Vec3]:
    tensor = torch.randn(*shape, 3, dtype=torch.float64)
    return tensor, Vec3.of(tensor)


def matrices(*shape: int) -> tuple[torch.Tensor, Mat3]:
    tensor = torch.randn(*shape, 3, 3, dtype=torch.float64)
    return tensor, Mat3.of(tensor)


@pytest.mark.parametrize("shape", [(), (5,), (2, 4)])
def test_stack_inverts_of(shape):
    a, a3 = vectors(*shape)
    m, m3 = matrices(*shape)
    assert a3.x.shape == shape
    assert torch.equal(a3.stack(), a)
    assert torch.equal(m3.stack(), m)


@pytest.mark.parametrize(
    ("own", "tensor"),
    [
        (lambda a, b: a + b, lambda a, b: a + b),
        (lambda a, b: a - b, lambda a, b: a - b),
        (lambda a, b: -a, lambda a, b: -a),
        (lambda a, b: a * 3.0, lambda a, b: 3.0 * a),
        (lambda a, b: a * b.x, lambda a, b: a * b[..., :1]),
        (lambda a, b: a / 3.0, lambda a, b: a / 3.0),
        (lambda a, b: a / b.z, lambda a, b: a / b[..., 2:]),
        (lambda a, b: a.scale(b), lambda a, b: a * b),
        (lambda a, b: a.cross(b), torch.linalg.cross),
        (lambda a, b: a.unit(), lambda a, b: a / a.norm(dim=-1, keepdim=True)),
        (lambda a, b: a.map(torch.maximum, b), torch.maximum),
        (lambda a, b: a.map(torch.abs), lambda a, b: a.abs()),
    ],
)
def test_vector_operations(own, tensor):
    (a, a3), (b, b3) = vectors(7), vectors(7)
    result = own(a3, b3)
    assert isinstance(result, Vec3)
    torch.testing.assert_close(result.stack(), tensor(a, b), rtol=ROUNDING, atol=ROUNDING)


def test_scalars_sums_zeros_and_units():
    (a, a3), (b, b3) = vectors(7), vectors(7)
    torch.testing.assert_close(a3.dot(b3), (a * b).sum(-1), rtol=0, atol=ROUNDING)
    torch.testing.assert_close(a3.norm(), a.norm(dim=-1), rtol=ROUNDING, atol=0)
    a = vectors(2)[1]
    assert len(a + a) == 3
    zero = Vec3.zeros_like(torch.ones(4, dtype=torch.float32))
    assert torch.equal(zero.stack(), torch.zeros(4, 3))
    assert zero.stack().dtype == torch.float32
    assert torch.isnan(Vec3.zeros_like(torch.zeros(())).unit().stack()).all()


def test_matrix_times_vector_and_transpose():
    (m, m3), (a, a3) = matrices(6), vectors(6)
    torch.testing.assert_close((m3 @ a3).stack(), (m @ a.unsqueeze(-1)).squeeze(-1), rtol=0, atol=10 * ROUNDING)
    assert torch.equal(m3.mT.stack(), m.mT)
    torch.testing.assert_close((m3.mT @ a3).stack(), (m.mT @ a.unsqueeze(-1)).squeeze(-1), rtol=0, atol=10 * ROUNDING)


def test_select_takes_row_by_row_and_ignores_nan_in_the_other():
    a = vectors(3)[1]
    nan = Vec3(*(torch.full((3,), torch.nan, dtype=torch.float64),) * 3)
    chosen = select(torch.tensor([True, False, True]), a, nan).stack()
    assert torch.equal(chosen[[0, 2]], a.stack()[[0, 2]])
    assert torch.isnan(chosen[1]).all()
