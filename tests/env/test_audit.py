"""What a step asks of the device: the host may wait for it a few times in a step, and never in a tick.

Measured in a step of NadirScan-v1, whatever the size of the batch: ``WAITS``. A loop of ticks waits once, to read the longest
duration; each number of a tick depends on tensors only.
"""

from collections import Counter

import pytest
import torch
from torch.fx.experimental.proxy_tensor import make_fx
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

import bsk_torch
from bsk_torch.sim.tick.runners import TickLoop
from tests.sim.run.runs import start_of

WAITS = 5
"""Waits of a step: are all actions legal, do the arcs reach (twice), how long is the longest duration, who lacks a window."""

READS = {"_local_scalar_dense", "equal", "is_nonzero", "nonzero", "masked_select", "_unique2", "unique_dim", "unique_consecutive"}
"""Operators whose result, or its shape, the host has to know."""

COPIES = {torch.Tensor.cpu, torch.Tensor.tolist, torch.Tensor.numpy}
"""Calls that copy to the host, which no operator shows where the device is the host."""


class Audit(TorchDispatchMode):
    """Lists the operators that run, with the shapes of their results, and counts the ``waits`` among them."""

    def __init__(self) -> None:
        super().__init__()
        self.waits: Counter[str] = Counter()
        self.ran: list[tuple[str, tuple[int, ...]]] = []
        self.copies = Copies(self.waits)

    def __enter__(self):
        self.copies.__enter__()
        return super().__enter__()

    def __exit__(self, *error):
        super().__exit__(*error)
        self.copies.__exit__(*error)

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        name, kwargs = func.overloadpacket.__name__, kwargs or {}
        by_mask = name.startswith("index") and any(
            getattr(index, "dtype", None) == torch.bool for part in args[1:2] if isinstance(part, list | tuple) for index in part
        )
        uneven = name == "repeat_interleave" and kwargs.get("output_size") is None
        moved = name == "_to_copy" and torch.device(kwargs.get("device") or "meta").type == "cpu"
        if name in READS or by_mask or uneven or moved:
            self.waits[name] += 1
        result = func(*args, **kwargs)
        if isinstance(result, torch.Tensor):
            self.ran.append((name, tuple(result.shape)))
        return result


class Copies(TorchFunctionMode):
    """Counts copies to the host."""

    def __init__(self, waits: Counter[str]) -> None:
        super().__init__()
        self.waits = waits

    def __torch_function__(self, func, types, args=(), kwargs=None):
        if func in COPIES:
            self.waits[func.__name__] += 1
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize(
    ("function", "waits"),
    [
        (lambda x: x.sum().item(), 1),
        (lambda x: bool((x > 0).any()), 1),
        (lambda x: x[x > 0], 1),
        (lambda x: x.index_put_((x > 0,), x.new_zeros(())), 1),
        (torch.nonzero, 1),
        (lambda x: torch.equal(x, x), 1),
        (lambda x: x.repeat_interleave(torch.tensor([1, 2, 3])), 1),
        (lambda x: x.cpu(), 1),
        (lambda x: x.tolist(), 1),
        (lambda x: torch.where(x > 0, x, -x)[torch.tensor([0, 1])].repeat_interleave(2).double(), 0),
    ],
)
def test_the_audit_sees_waits(function, waits):
    with Audit() as audit:
        function(torch.arange(3.0))
    assert sum(audit.waits.values()) == waits, audit.waits


@pytest.fixture(scope="module", params=[4, 64])
def started(request):
    """An environment, and what has been seen of it after a reset."""
    env = bsk_torch.make("NadirScan-v1", num_envs=request.param, seed=4, backend="eager", max_step_duration=20.0)
    return env, env.reset()


@pytest.mark.nightly("64")
def test_a_step_waits_for_the_device_a_few_times(started):
    """After the first step, which checks tables of actions."""
    env, td = started
    td = env.step(td.set("action", torch.arange(len(td)) % 4))["next"]
    for _ in range(3):
        with Audit() as audit:
            td = env.step(td.set("action", torch.arange(len(td)) % 4))["next"]
        assert sum(audit.waits.values()) == WAITS, audit.waits


@pytest.mark.nightly("64")
def test_ticks_never_wait_and_never_change_shape(started):
    simulator = started[0].simulator
    seen, inside = [], []

    def step(*tensors):
        with Audit() as audit:
            result = simulator.tick.step(*tensors)
        seen.append(audit.ran)
        inside.append(sum(audit.waits.values()))
        return result

    for ticks in (5, 50):
        start, counts = start_of(simulator), torch.arange(simulator.num_envs) % ticks
        counts[-1] = ticks
        seen.clear()
        with Audit() as audit:
            start.run(TickLoop(simulator.tick.step), counts)
        assert audit.waits == {"_local_scalar_dense": 1}, f"{ticks} ticks"
        start_of(simulator).run(TickLoop(step), counts)
        assert len(seen) == ticks
        assert all(ran == seen[0] for ran in seen), "a tick ran other operators, or on other shapes"
        assert not any(inside)


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
