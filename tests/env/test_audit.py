"""What runs on a device: the numbers are those of the host, and the host waits a few times in a step, and never in a tick.

No machine of these tests has a GPU, so the device is one that :mod:`tests.support.elsewhere` makes up.
"""

from typing import Any

import pytest
import torch
from torch.fx.experimental.proxy_tensor import make_fx

import bsk_torch
from bsk_torch.sim.tick.runners import TickLoop
from tests.env.default_dtype import chosen
from tests.sim.run.runs import start_of
from tests.support.elsewhere import NAME, Device


@pytest.mark.parametrize(
    ("function", "waits"),
    [
        (lambda x: x.sum().item(), 1),
        (lambda x: bool((x > 0).any()), 1),
        (lambda x: x[x > 0], 1),
        (lambda x: x.index_put_((x > 0,), x.new_zeros(())), 1),
        (torch.nonzero, 1),
        (lambda x: torch.equal(x, x), 1),
        (lambda x: x.repeat_interleave(x.long()), 1),
        (lambda x: x.cpu(), 1),
        (lambda x: x.tolist(), 1),
        (lambda x: torch.tensor([1.0], device=x.device), 1),
        (lambda x: x.new_tensor([1.0]), 1),
        (lambda x: x.copy_(torch.zeros(3)), 1),
        (lambda x: x[torch.tensor([0, 1])], 1),
        (lambda x: torch.zeros(3)[torch.zeros(3) > 0].tolist(), 0),
        (lambda x: torch.where(x > 0, x, -x)[torch.arange(2, device=x.device)].repeat_interleave(2).double() + 1.0, 0),
    ],
)
def test_waits_are_counted(function, waits):
    with Device() as device:
        function(torch.full((3,), 2.0, device=NAME))
        assert sum(device.waits.values()) == waits, device.waits


@pytest.mark.parametrize(
    ("function", "error"),
    [
        (lambda x: x + torch.zeros(3), RuntimeError),
        (lambda x: torch.cat([x, torch.zeros(1)]), RuntimeError),
        (lambda x: x.numpy(), TypeError),
        (lambda x: x.data_ptr(), TypeError),
    ],
)
def test_host_and_device_do_not_mix(function, error):
    with Device(), pytest.raises(error, match=r"on the host|to the host"):
        function(torch.full((3,), 2.0, device=NAME))


SHORT: dict[str, Any] = {"max_step_duration": 5.0, "time_limit": 600.0}

THREE: dict[str, Any] = {"n_satellites": 3, "n_planes": 1, "phasing": 0}

CASES: dict[str, tuple[str, int, dict[str, Any], int]] = {
    "4": ("NadirScan-v1", 4, {}, 4),
    "64": ("NadirScan-v1", 64, {}, 4),
    "AEOS-v1": ("AEOS-v1", 3, {"n_targets": 600}, 3),
    "Constellation-v1": ("Constellation-v1", 3, {**THREE, "n_targets": 300}, 8),
    "CWDocking-v1": ("CWDocking-v1", 3, {}, 4),
}
"""Preset, environments, options, and how often the host waits for the device in a step that needs no further orbits or windows.

It reads the range of the actions; with the longest run, whether all arcs are long enough; whether eclipses and windows are known.
"""


def played(preset: str, steps: int, num_envs: int, used: Device | None, **options: Any) -> list[dict[str, torch.Tensor]]:
    """What the steps of some episodes return, on the host, and ``waits`` of each step."""
    env: Any = bsk_torch.make(preset, num_envs=num_envs, seed=4, **SHORT, **options)
    td, steps_seen = env.reset(), []
    for number in range(steps):
        actions = chosen(env, td.to("cpu"), number).to(env.device)
        if used is not None:
            used.waits.clear()
        td = env.step(actions)["next"]
        waits = {} if used is None else dict(used.waits)
        steps_seen.append({"waits": waits, **{str(key): value.cpu() for key, value in td.items(True, True)}})
    return steps_seen


@pytest.mark.parametrize("case", CASES)
def test_a_step_waits_for_the_device_a_few_times(case):
    """And its numbers are those of the host."""
    preset, num_envs, options, waits = CASES[case]
    with torch.no_grad():
        expected = played(preset, 4, num_envs, None, backend="eager", **options)
        with Device() as device:
            found = played(preset, 4, num_envs, device, device=NAME, **options)
    for one, other in zip(found, expected, strict=True):
        differing = [name for name in one if name != "waits" and not torch.equal(one[name], other[name])]
        assert one.keys() == other.keys()
        assert not differing
    assert min(sum(step["waits"].values()) for step in found) == waits, [step["waits"] for step in found]


@pytest.mark.parametrize("num_envs", [4, 64])
def test_ticks_never_wait_and_never_change_shape(num_envs):
    with torch.no_grad(), Device() as device:
        env = bsk_torch.make("NadirScan-v1", num_envs=num_envs, seed=4, device=NAME, **SHORT)
        env.reset()
        simulator, ticks_seen = env.simulator, []

        def step(*tensors):
            device.ran.clear()
            result = simulator.tick.step(*tensors)
            ticks_seen.append(list(device.ran))
            return result

        for ticks in (3, 12):
            counts = torch.arange(num_envs, device=NAME) % ticks
            counts[-1] = ticks
            ticks_seen.clear()
            start = start_of(simulator)
            device.waits.clear()
            start.run(TickLoop(step), counts)
            assert sum(device.waits.values()) == 1, f"{ticks} ticks"  # the longest
            assert len(ticks_seen) == ticks
            assert all(ran == ticks_seen[0] for ran in ticks_seen), "a tick ran other operators, or on other shapes"


def test_a_tick_does_not_look_at_its_data():
    """On tensors without data, or sizes, it is the same tick."""
    env = bsk_torch.make("NadirScan-v1", num_envs=4, seed=4, backend="eager")
    env.reset()
    simulator = env.simulator
    start = start_of(simulator)
    now, flags = start.ticks.double() + 1.0, start.flags[:, start.mode]
    parts = *(track.table for track in start.tracks), *(track.start for track in start.tracks)
    inputs = start.state, start.shared, start.own, flags, now, now + 1.0, *parts
    graph = make_fx(lambda *tensors: simulator.tick.step(*tensors), tracing_mode="symbolic", _allow_non_fake_inputs=True)(*inputs)
    torch.testing.assert_close(graph(*inputs), simulator.tick.step(*inputs), rtol=0, atol=0)
