"""Random sequences of calls on every preset, against four laws.

* A call gives a right result, or an error that says what is wrong.
* What agents see is finite.
* Episodes do not depend on the batch: two of four, alone in another environment, are equal bit for bit.
* A call that fails leaves everything as it was.
"""

import functools
import pickle
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

import bsk_torch
from bsk_torch.presets import PRESETS

pytestmark = pytest.mark.compiled

NUM_ENVS = 4

PART = [2, 0]
"""Episodes of the first environment that the second one plays, too."""

LIMIT = 1500.0
"""Time limit of episodes, s: sequences see their ends."""

OPTIONS: dict[str, dict[str, Any]] = {
    "AEOS-v1": dict(n_targets=100),
    "AEOSPower-v1": dict(n_targets=100),
    "CloudyAEOS-v1": dict(n_targets=100),
    "Constellation-v1": dict(n_satellites=3, n_planes=1, phasing=0, n_targets=300),
    "AEOSConstellation-v1": dict(n_targets=300),
    "Services-v1": dict(n_targets=12),
    "ThreeSensors-v1": dict(n_targets=12),
    "Walker4-v1": dict(n_targets=12),
    "AEOSBench-v1": dict(satellites=(1, 3), tasks=(5, 12)),
}
"""What makes presets small."""

ERRORS = ValueError, TypeError, KeyError, IndexError, RuntimeError
"""Kinds of errors that say what is wrong."""

ALIKE = ("FaultyScan-v1", "NadirScience-v1", "AEOSCity-v1", "CloudyAEOS-v1", "AEOSConstellation-v1")
"""Presets that are another one with other draws, tested at night."""

MASKS = st.lists(st.booleans(), min_size=NUM_ENVS, max_size=NUM_ENVS)


@functools.cache
def environments(preset: str) -> tuple[Any, Any]:
    """The environments of a preset, which all sequences use: every sequence begins with a seed and a reset of both."""
    options = OPTIONS.get(preset, {}) | dict(time_limit=LIMIT, dtype=torch.float64)
    return tuple(bsk_torch.make(preset, num_envs=len(ids), env_ids=ids, **options) for ids in (list(range(NUM_ENVS)), PART))  # type: ignore[return-value]


def groups(env: Any) -> list[tuple[str, ...]]:
    """Where the entries of agents lie."""
    return [(name,) for name in getattr(env, "group_map", {})] or [()]


def alive(env: Any, where: tuple[str, ...], row: int) -> bool:
    """Whether any satellite of a group is alive in an episode: actions of dead ones are ignored, whatever they are."""
    return not where or not bool(env.dead[row, [env.names.index(name) for name in env.group_map[where[0]]]].all())


def real(td: TensorDictBase, where: tuple[str, ...]) -> bool:
    """Whether actions of a group are real numbers."""
    return ((*where, "action_mask") if where else "action_mask") not in td.keys(True)


def numbers(spec: Any, ids: Tensor, number: int) -> Tensor:
    """Actions [N, ..., A] within the bounds of a specification, which depend on episode, place and a number only."""
    low, high = spec.space.low, spec.space.high
    place = torch.arange(low[0].numel()).view(low.shape[1:])
    share = (0.37 * (ids.view(-1, *[1] * place.ndim) * 7 + place * 3 + number)) % 1.0
    return (low + share * (high - low)).to(spec.dtype)


def leaves(td: TensorDictBase) -> dict[Any, Tensor]:
    """Tensors by key, those of saved states left out."""
    return {key: value for key, value in td.items(True, True) if "state" not in (key if isinstance(key, tuple) else (key,))}


def same(a: TensorDictBase, b: TensorDictBase) -> bool:
    """Whether two states are equal, NaN included."""
    one, other = (dict(td.items(True, True)) for td in (a, b))
    return one.keys() == other.keys() and all(torch.equal(bits(value), bits(other[key])) for key, value in one.items())


def bits(value: Tensor) -> Tensor:
    """A float64 tensor as integers."""
    return value.contiguous().view(torch.int64) if value.dtype == torch.float64 else value


class Sequence(RuleBasedStateMachine):
    """Calls of a preset's two environments."""

    preset = ""

    @initialize(seed=st.integers(0, 3))
    def begin(self, seed: int) -> None:
        self.whole, self.part = environments(self.preset)
        self.saved: list[tuple[TensorDictBase, TensorDictBase]] = []
        self.pickled = False
        for env in (self.whole, self.part):
            env.set_seed(seed)
        self.td, self.other = self.whole.reset(), self.part.reset()
        self.check()

    # -- laws ---------------------------------------------------------------------------------------------------------

    def check(self) -> None:
        """Compare the two environments, and look for numbers that are not finite."""
        mine, theirs = leaves(self.td), leaves(self.other)
        for key in mine.keys() & theirs.keys():  # rewards are shown by steps only
            value = mine[key]
            if value.dtype.is_floating_point:
                assert torch.isfinite(value).all(), key
            assert torch.equal(value[PART], theirs[key]), key

    def refused(self, call: Any) -> None:
        """Make a call of the first environment that must fail in words, and change nothing."""
        before = self.whole.get_state()
        with pytest.raises(ERRORS) as caught:
            call()
        assert len(str(caught.value)) > 20
        assert same(before, self.whole.get_state())

    # -- calls that work ----------------------------------------------------------------------------------------------

    def actions(self, td: TensorDictBase, env: Any, ids: Tensor, number: int) -> TensorDictBase:
        """Legal actions that depend on episode, agent and a number only."""
        td = td.clone()
        for where in groups(env):
            key = (*where, "action") if where else "action"
            if real(td, where):
                td[key] = numbers(env.full_action_spec[key], ids, number)
                continue
            mask = td[(*where, "action_mask")] if where else td["action_mask"]
            size = mask.shape[-1]
            agents = torch.arange(mask[0].numel() // size).view(mask.shape[1:-1])
            start = ids.view(-1, *[1] * agents.ndim) * 7 + agents * 3 + number
            order = (
                (torch.arange(size) * 5 + start.unsqueeze(-1)) % size
                if size % 5
                else (torch.arange(size) + start.unsqueeze(-1)) % size
            )
            td[key] = torch.where(mask, order, -1).argmax(-1)
        return td

    def step(self, number: int, moves: Tensor | None) -> None:
        ids = torch.arange(NUM_ENVS)
        both = []
        for env, td, rows in ((self.whole, self.td, ids), (self.part, self.other, ids[PART])):
            td = self.actions(td, env, rows, number)
            if moves is not None:
                td["_step"] = moves[rows]
            both.append(env.step(td)["next"])
        self.td, self.other = both
        self.check()
        ended = self.td["done"].flatten()
        if bool(ended.any()):
            self.restart(ended)

    def restart(self, rows: Tensor) -> None:
        """Begin new episodes; TorchRL takes the other rows from the tensordict that it is given."""
        self.td = self.whole.reset(self.td.set("_reset", rows.unsqueeze(-1)))
        if bool(rows[PART].any()):
            self.other = self.part.reset(self.other.set("_reset", rows[PART].unsqueeze(-1)))
        # TorchRL leaves rewards of the last step where all rows begin again, and zeros where some do
        self.td, self.other = (
            td.exclude(*(key for key in td.keys(True, True) if "reward" in key)) for td in (self.td, self.other)
        )
        self.check()

    @rule(number=st.integers(0, 30))
    def act(self, number: int) -> None:
        self.step(number, None)

    @rule(number=st.integers(0, 30), moves=MASKS)
    def act_in_some(self, number: int, moves: list[bool]) -> None:
        if any(moves[row] for row in PART):  # TorchRL calls no environment in which nothing moves
            self.step(number, torch.tensor(moves))

    @rule(number=st.integers(0, 30))
    def act_in_another_thread(self, number: int) -> None:
        with ThreadPoolExecutor(1) as pool:
            pool.submit(self.step, number, None).result()

    @rule(rows=MASKS)
    def begin_anew(self, rows: list[bool]) -> None:
        if any(rows):
            self.restart(torch.tensor(rows))

    @rule()
    def save(self) -> None:
        self.saved.append((self.whole.get_state(), self.part.get_state()))

    @precondition(lambda self: not self.pickled)  # once: it takes as long as hundreds of steps
    @rule()
    def pickle_and_go_on(self) -> None:
        self.pickled = True
        self.whole = pickle.loads(pickle.dumps(self.whole))

    @precondition(lambda self: self.saved)
    @rule(k=st.integers(0, 100))
    def go_back(self, k: int) -> None:
        states = self.saved[k % len(self.saved)]
        self.td, self.other = (
            env.reset(TensorDict({"state": state}, env.batch_size), set_state=True)
            for env, state in zip((self.whole, self.part), states, strict=True)
        )
        self.check()

    # -- calls that fail ----------------------------------------------------------------------------------------------

    @rule(row=st.integers(0, NUM_ENVS - 1), value=st.sampled_from([10**6, -(10**6), 2**62, -(2**63)]))
    def act_out_of_range(self, row: int, value: int) -> None:
        for where in groups(self.whole):
            if not alive(self.whole, where, row):
                continue
            td, key = self.actions(self.td, self.whole, torch.arange(NUM_ENVS), 0), (*where, "action") if where else "action"
            td[key][row] = torch.nan if real(td, where) else value  # real numbers are clamped
            self.refused(functools.partial(self.whole.step, td))

    @rule(change=st.sampled_from(["float", "shape", "missing", "bool"]))
    def act_in_a_wrong_form(self, change: str) -> None:
        where = groups(self.whole)[0]
        td, key = self.actions(self.td, self.whole, torch.arange(NUM_ENVS), 0), (*where, "action") if where else "action"
        numbered = real(td, where)
        action = td.pop(key) if isinstance(key, str) else td[where].pop("action")
        wrong = {
            "float": action.to(torch.complex64) if numbered else action.double(),
            "bool": action > 0,
            "shape": action.unsqueeze(-1).expand(*action.shape, 2),
            "missing": None,
        }
        if wrong[change] is not None:
            td[key] = wrong[change]
        self.refused(lambda: self.whole.step(td))

    @precondition(lambda self: self.saved)
    @rule(pick=st.integers(0, 10**6), change=st.sampled_from(["lost", "shape", "nan", "type"]))
    def restore_what_is_damaged(self, pick: int, change: str) -> None:
        state = self.saved[-1][0].clone()
        keys = sorted((key for key in state.keys(True, True)), key=str)
        key = keys[pick % len(keys)]
        value = state[key]
        if change == "nan" and not value.dtype.is_floating_point:
            change = "type"
        if change == "lost":
            state = state.exclude(key)
        elif change == "nan":
            state[key] = torch.full_like(value, torch.nan)
        elif change == "type":
            state[key] = value.to(torch.complex64)
        else:
            state[key] = value.unsqueeze(-1).repeat(*[1] * value.ndim, 3)
        before, failed = self.whole.get_state(), None
        try:
            self.whole.restore(state, torch.arange(NUM_ENVS))
        except ERRORS as error:
            failed = error
        if failed is None:  # the damage makes no difference
            self.whole.restore(before, torch.arange(NUM_ENVS))
        else:
            assert len(str(failed)) > 20
            assert same(before, self.whole.get_state())

    @rule(rows=st.lists(st.integers(-3, 9), max_size=5))
    def restore_into_rows_that_do_not_exist(self, rows: list[int]) -> None:
        state = self.whole.get_state()
        legal = all(0 <= row < NUM_ENVS for row in rows) and len(set(rows)) == len(rows)
        if not legal:
            self.refused(lambda: self.whole.restore(state, torch.tensor(rows), torch.zeros(len(rows), dtype=torch.int64)))


def machine(preset: str) -> type[Sequence]:
    return type(f"Sequence of {preset}", (Sequence,), {"preset": preset})


def run(preset: str, examples: int, calls: int) -> None:
    chosen = settings(
        max_examples=examples,
        stateful_step_count=calls,
        derandomize=examples < 50,  # the same sequences for the same code in CI, others every night
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    run_state_machine_as_test(machine(preset), settings=chosen)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.nightly(*ALIKE)
def test_random_sequences_keep_the_laws(preset):
    run(preset, 3, 20)


@pytest.mark.nightly
@pytest.mark.parametrize("preset", PRESETS)
def test_many_random_sequences_keep_the_laws(preset):
    run(preset, 100, 40)
