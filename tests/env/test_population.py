"""Episodes in which some satellites take no part: the others are as if they were alone, and nothing is done for the absent."""

import pickle
from collections.abc import Sequence

import pytest
import torch
from pettingzoo.test import parallel_api_test
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.envs.utils import check_env_specs

import bsk_torch
from bsk_torch import ConstellationTasking, GeneralSatelliteTasking, SatelliteTasking, act, comm, data, obs, sats, scene
from bsk_torch.env.assembly.fleets import between
from bsk_torch.lab.planners import Rollout
from bsk_torch.rand import Key
from bsk_torch.rl.evaluation.evaluate import evaluate
from bsk_torch.rl.marl.mappo import MAPPOConfig, MAPPOTraining
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.access.lookahead import LookAhead
from bsk_torch.tasks.inspection import SphericalRSO
from bsk_torch.viz.episodes import record
from bsk_torch.wrappers import PettingZooEnv
from tests.env.test_constellation import Linked, Relay
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

BACKENDS = ["eager", "compiled"]
LIMIT = 600.0
NUMBERS = (3, 1, 5, 2)
"""Satellites of each environment, where the first ones are present."""


class Imager(sats.ImagingSatellite):
    observation_spec = (
        obs.SatProperties(dict(prop="storage_level_fraction"), dict(prop="r_BN_P", norm=7e6), dict(prop="battery_charge")),
        obs.OpportunityProperties(dict(prop="priority"), dict(prop="target_angle"), n_ahead_observe=3),
        obs.Eclipse(),
        obs.Time(),
    )
    action_spec = (act.Charge(duration=47.0), act.Drift(duration=31.0), act.Image(n_ahead_image=3))
    dyn_type = Linked
    fsw_type = fsw.ImagingFSWModel


class Scanner(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction"), dict(prop="r_BN_P", norm=7e6)), obs.Time())
    action_spec = (act.Scan(duration=60.0), act.Charge(duration=120.0))
    dyn_type = dyn.ContinuousImagingDynModel
    fsw_type = fsw.ContinuousImagingFSWModel


ARGS = dict(imageAttErrorRequirement=0.2, imageRateErrorRequirement=0.2, u_max=0.4, imageTargetMinimumElevation=0.2)


class FirstOnes(scene.UniformTargets):
    """As many satellites as ``NUMBERS`` says, the first of the list."""

    def present(self, key: Key, names: Sequence[str]) -> Tensor:
        numbers = torch.tensor(NUMBERS)[key.env_id % len(NUMBERS)]
        return torch.arange(len(names)) < numbers.unsqueeze(1)


def imagers(count: int) -> list[sats.Satellite]:
    return [Imager(f"EO{k}", ARGS, may_see_nothing=True) for k in range(count)]


def mixed(count: int) -> list[sats.Satellite]:
    """Imagers and relays by turns."""
    return [Relay(f"R{k}") if k % 2 else Imager(f"EO{k}", ARGS, may_see_nothing=True) for k in range(count)]


def build(
    satellites: list[sats.Satellite], scenario: type[scene.Scenario] = FirstOnes, **options: object
) -> ConstellationTasking:
    given: dict[str, object] = dict(
        num_envs=4, seed=5, time_limit=LIMIT, max_step_duration=200.0, world_args=dict(utc_init="2018 SEP 29 21:00:00.000 (UTC)")
    )
    link = comm.LOSMultiCommunication()
    return ConstellationTasking(satellites, scenario(300), data.UniqueImageReward(), link, **{**given, **options})


def scanners(count: int, n: int = 4, **options: object) -> ConstellationTasking:
    given: dict[str, object] = dict(num_envs=n, seed=3, time_limit=LIMIT)
    satellites = [Scanner(f"S{k}", dict(panelArea=1e-3)) for k in range(count)]
    return ConstellationTasking(satellites, scene.UniformNadirScanning(), data.ScanningTimeReward(), **{**given, **options})


def choose(env: ConstellationTasking, td: TensorDict, step: int) -> TensorDict:
    """Give legal actions that depend on environment, satellite's number and step alone."""
    for group in env.groups:
        mask = td[group.name, "action_mask"]
        wish = (env.env_ids.unsqueeze(1) * 7 + group.members[:, 0] * 3 + step * 5) % mask.shape[-1]
        order = (torch.arange(mask.shape[-1]) - wish.unsqueeze(-1)) % mask.shape[-1]
        td[group.name, "action"] = torch.where(mask, order, 1000).argmin(-1)
    return td


def history(env: ConstellationTasking, steps: int) -> list[TensorDict]:
    td = env.reset()
    seen = [td.clone()]
    for step in range(steps):
        td = env.step(choose(env, td, step))["next"]
        seen.append(td.clone())
        begin = td["done"].squeeze(-1)
        if bool(begin.any()):
            td = env.reset(TensorDict({"_reset": td["done"]}, env.batch_size))
    return seen


def of_satellites(env: ConstellationTasking, td: TensorDict, row: int) -> dict[str, dict[str, Tensor]]:
    """Return all that the agents of an environment were shown, by name of the satellite."""
    found = {}
    for group in env.groups:
        for k, agent in enumerate(group.agents):
            found[agent] = {
                ".".join([key] if isinstance(key, str) else key): v[row, k] for key, v in td[group.name].items(True, True)
            }
    return found


# -- the present ones are as if they were alone -------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("satellites", [imagers, mixed])
@pytest.mark.nightly("eager")
def test_satellites_that_are_present_are_as_if_the_others_did_not_exist(satellites, backend) -> None:
    steps, rows = (
        (8, (0, 1, 2, 3)) if backend == "compiled" else (2, (0, 3))
    )  # the eager one is slow, and decides alike: see below
    env = build(satellites(5), backend=backend)
    whole = history(env, steps)
    assert whole
    for row in rows:
        alone = build(satellites(NUMBERS[row]), scene.UniformTargets, num_envs=1, env_ids=[row], backend=backend)
        for one, many in zip(history(alone, steps), whole, strict=True):
            theirs, mine = of_satellites(alone, one, 0), of_satellites(env, many, row)
            for name, leaves in theirs.items():
                for leaf, value in leaves.items():
                    assert torch.equal(value, mine[name][leaf]), (name, leaf)
            for key in ("done", "terminated", "truncated", "duration"):
                assert torch.equal(one[key][0], many[key][row])


@pytest.mark.parametrize("satellites", [imagers, mixed])
@pytest.mark.nightly("imagers")
def test_both_back_ends_agree_on_who_is_present(satellites) -> None:
    eager, compiled = (history(build(satellites(5), backend=backend), 6) for backend in BACKENDS)
    assert eager
    for one, other in zip(eager, compiled, strict=True):
        for key, leaf in one.items(True, True):
            assert torch.allclose(leaf.double(), other[key].double(), rtol=1e-5, atol=1e-6), key


def test_absent_satellites_make_no_difference() -> None:
    """Of five satellites with given arguments, the second and the fourth fly as the two alone, after as many steps."""

    class Some(scene.UniformNadirScanning):
        def present(self, key: Key, names: Sequence[str]) -> Tensor:
            return torch.tensor([False, True, False, True, False]).expand(len(key), -1)

    def scanner(name: str) -> Scanner:
        spin = 0.01 * int(name[1:])
        start = dict(rN=[7e6, 0.0, 0.0], vN=[0.0, 5e3 + 100.0 * spin, 5.6e3], sigma_init=[0.1, spin, 0.3], storedCharge_Init=2e5)
        return Scanner(
            name, start | dict(omega_init=[0.0, spin, 0.0], wheelSpeeds=[0.0, 10.0, 20.0], disturbance_vector=[0.0, 0.0, 1e-4])
        )

    def make(names: Sequence[str], scenario: scene.Scenario) -> ConstellationTasking:
        when = dict(utc_init="2018 SEP 29 21:00:00.000 (UTC)")
        satellites = [scanner(name) for name in names]
        return ConstellationTasking(
            satellites, scenario, data.ScanningTimeReward(), num_envs=2, seed=1, time_limit=LIMIT, world_args=when
        )

    seen = []
    many, two = make([f"S{k}" for k in range(5)], Some()), make(["S1", "S3"], scene.UniformNadirScanning())
    for env, columns in ((many, [1, 3]), (two, [0, 1])):
        td, states = env.reset(), []
        for step in range(4):
            action = torch.full((2, env.fleet.size), 2)
            action[:, columns] = torch.tensor([step % 2, (step + 1) % 2])
            td["agents", "action"] = action
            td = env.step(td)["next"]
            states.append(td["agents"][:, columns].clone())
        seen.append(states)
    assert [len(states) for states in seen] == [4, 4]
    for one, other in zip(*seen, strict=True):
        assert (one == other).all()


# -- nothing is done for the absent -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.nightly("eager")
def test_absent_satellites_run_no_ticks_and_are_shown_as_nothing(backend) -> None:
    env = build(mixed(5), backend=backend)
    td = env.reset()
    absent = ~env.present
    assert env.present.sum(1).tolist() == list(NUMBERS)
    before = [(simulator.state.planes.clone(), simulator.arcs.flown.clone()) for simulator in env.fleet.simulators]
    for step in range(6):
        td = env.step(choose(env, td, step))["next"]
        for group in env.groups:
            gone = absent[:, group.members[:, 0]]
            assert torch.equal(td[group.name, "mask"], ~gone)
            assert not td[group.name, "observation"][gone].any()
            assert not td[group.name, "reward"][gone].any()
            assert not td[group.name, "requires_retasking"][gone].any()
            assert not td[group.name, "action_mask"][gone][:, :-1].any()
            assert td[group.name, "action_mask"][gone][:, -1].all()
        assert not env.links[absent].any()
        assert not env.links.mT[absent].any()
        assert not env.dead[absent].any()
        assert all(not count[absent].any() for count in env.counts().values())
    for k, (simulator, (planes, flown)) in enumerate(zip(env.fleet.simulators, before, strict=True)):
        rows = env.fleet.rows_of(k, absent)
        assert not simulator.ticks[rows].any()
        assert torch.equal(simulator.state.planes[:, rows], planes[:, rows])
        assert torch.equal(simulator.arcs.flown[rows], flown[rows])
    env.check_finite()


def test_kernels_skip_absent_satellites(monkeypatch) -> None:
    """Rows of absent satellites come last in their tiles, as padding."""
    from bsk_torch.codegen import kernel

    seen = []
    original = kernel.in_tiles

    def noted(*args: object) -> object:
        tiles = original(*args)
        seen.append((args, tiles))
        return tiles

    monkeypatch.setattr(kernel, "in_tiles", noted)
    env = build(imagers(5))
    env.step(choose(env, env.reset(), 0))
    (_, _, _, group, _, present), tiles = seen[-1]
    assert group == 5
    assert torch.equal(present, env.present.flatten())
    runs = tiles.groups < len(tiles.ends) - 1
    assert sorted(tiles.rows[runs].tolist()) == torch.nonzero(present).flatten().tolist()
    assert bool((runs.long().diff(dim=1) <= 0).all()), "those that run fill the first blocks"


def test_no_orbits_are_solved_for_the_absent(monkeypatch) -> None:
    solved = []
    original = LookAhead.solve
    monkeypatch.setattr(LookAhead, "solve", lambda self, rows, *args: (solved.append(len(rows)), original(self, rows, *args))[1])
    env = build(imagers(5))
    solved.clear()
    env.reset()
    assert solved == [sum(NUMBERS)]


def test_dying_ends_an_episode_when_all_who_are_present_have_died() -> None:
    env = scanners(5, population=(2, 2))
    td = env.reset()
    task = env.satellites[0].task
    first = env.present.long().argmax(1)
    dead = torch.zeros_like(env.present).scatter(1, first.unsqueeze(1), True)
    env.simulator.state.write("charge", dead.flatten(), torch.zeros(20, dtype=torch.float64))
    td = env.step(choose(env, td, 0))["next"]
    assert torch.equal(env.dead, dead)
    assert not td["done"].any()
    assert td["agents", "reward"].squeeze(-1)[dead].lt(0.0).all()
    assert td["agents", "mask"].sum(1).tolist() == [1] * 4
    env.simulator.state.write("charge", env.present.flatten(), torch.zeros(20, dtype=torch.float64))
    td = env.step(choose(env, td, 1))["next"]
    assert td["terminated"].all()
    assert not task.dead.view(4, 5)[~env.present].any()


def test_idle_agents_are_warned_of_and_absent_ones_are_not(caplog) -> None:
    env = scanners(5, population=(1, 4))
    td = env.reset()
    mask = td["agents", "action_mask"]
    td["agents", "action"] = torch.where(mask[..., 0], 0, mask.shape[-1] - 1)
    env.step(td)
    assert "requires retasking" not in caplog.text
    td = env.reset()
    td["agents", "action"] = torch.full(mask.shape[:2], mask.shape[-1] - 1)
    env.step(td)
    assert "requires retasking" in caplog.text


# -- states, wrappers, planners, learning --------------------------------------------------------------------------------------


def test_states_and_copies_have_the_same_population() -> None:
    env = build(mixed(5))
    td = env.reset()
    td = env.step(choose(env, td, 0))["next"]
    state = env.get_state()
    other, pickled = env.like(4), pickle.loads(pickle.dumps(env))
    other.reset()
    other.restore(env, [0, 1, 2, 3], [2, 0, 3, 1])
    assert torch.equal(other.present, env.present[[2, 0, 3, 1]])
    other.restore(state)
    expected = env.step(choose(env, td, 1))["next"]
    for copy in (other, pickled):
        found = copy.step(choose(copy, td, 1))["next"]
        assert all(torch.equal(leaf, found[key]) for key, leaf in expected.items(True, True))
    wrong = state.clone()
    wrong["removed"] = torch.zeros_like(wrong["removed"])
    check_refusals(refusal(lambda: env.restore(wrong), ValueError, "'removed'", "present"))
    empty = state.clone()
    for k in range(2):
        empty[f"satellites_{k}", "present"] = torch.zeros_like(empty[f"satellites_{k}", "present"])
    with pytest.raises(ValueError, match=r"present|ticks"):
        env.restore(empty)


def test_prepared_and_partly_reset_episodes_have_their_population() -> None:
    """A batch of 40 satellites has a pool; its episodes are those of environments without one."""
    many = scanners(10, population=(1, 10))
    assert many.pool is not None
    every, again = [], []
    many.reset()
    for _ in range(3):
        every.append(many.present.clone())
        many.reset()
    for env_id in range(4):
        one = scanners(2, 1, population=(1, 2), env_ids=[env_id])
        one.reset()
    fresh = scanners(10, 4, population=(1, 10))
    fresh.reset()
    for _ in range(3):
        again.append(fresh.present.clone())
        fresh.reset(TensorDict({"_reset": torch.ones(4, 1, dtype=torch.bool)}, [4]))
    assert all(torch.equal(one, other) for one, other in zip(every, again, strict=True))
    assert len({tuple(present.flatten().tolist()) for present in every}) == 3
    assert bool((torch.stack(every).sum(-1) >= 1).all())


def test_numbers_and_choices_of_satellites_are_equally_likely() -> None:
    present = between(
        Key(torch.zeros(9000, dtype=torch.int64), torch.arange(9000), torch.zeros(9000, dtype=torch.int64)), 2, 4, 5
    )
    numbers = present.sum(1)
    for number in (2, 3, 4):
        assert abs(float((numbers == number).double().mean()) - 1.0 / 3.0) < 0.02
    assert (numbers.min(), numbers.max()) == (2, 4)
    assert (present.double().mean(0) - 0.6).abs().max() < 0.02


def test_one_agent_for_all_meets_the_present_alone() -> None:
    env = GeneralSatelliteTasking(
        [Scanner(f"S{k}") for k in range(4)],
        scene.UniformNadirScanning(),
        data.ScanningTimeReward(),
        num_envs=3,
        seed=3,
        time_limit=LIMIT,
        population=(1, 3),
    )
    td = env.reset()
    each = td["observation"].view(3, 4, -1)
    assert torch.equal(each.abs().sum(-1) > 0.0, env.present)
    assert torch.equal(td["members_require_retasking"], env.present)
    td["action"] = torch.where(env.present, 0, 2)
    td = env.step(td)["next"]
    assert not td["done"].any()
    assert td["reward"].isfinite().all()
    check_env_specs(env)


def test_agents_of_several_satellites_are_present_with_any_of_them() -> None:
    class Two(scene.UniformNadirScanning):
        def present(self, key: Key, names: Sequence[str]) -> Tensor:
            return torch.tensor([[False, True, True, False], [False, False, True, True]])[key.env_id % 2]

    env = ConstellationTasking(
        [Scanner(f"S{k}") for k in range(4)],
        Two(),
        data.ScanningTimeReward(),
        num_envs=2,
        seed=3,
        time_limit=LIMIT,
        meta_agent_groupings={"pair": ["S0", "S1"]},
    )
    td = env.reset()
    masks = {agent: td[group.name, "mask"][:, k] for group in env.groups for k, agent in enumerate(group.agents)}
    assert {agent: mask.tolist() for agent, mask in masks.items()} == {
        "pair": [True, False],
        "S2": [True, True],
        "S3": [False, True],
    }
    single = ConstellationTasking(
        [Scanner(f"S{k}") for k in range(4)],
        Two(),
        data.ScanningTimeReward(),
        seed=3,
        meta_agent_groupings={"pair": ["S0", "S1"]},
    )
    view = PettingZooEnv(single)
    view.reset()
    assert set(view.agents) == {"pair", "S2"}


def test_a_satellite_alone_is_always_present() -> None:
    env = SatelliteTasking(
        Imager("EO0", ARGS, may_see_nothing=True), FirstOnes(100), data.UniqueImageReward(), num_envs=2, seed=1
    )
    env.reset()
    assert env.present.tolist() == [[True], [True]]
    check_refusals(refusal(lambda: SatelliteTasking(Scanner("S0"), population=(1, 1)), TypeError, "population"))


def test_rejects_wrong_populations() -> None:
    class Nobody(scene.Scenario):
        def present(self, key: Key, names: Sequence[str]) -> Tensor:
            return torch.zeros(len(key), len(names), dtype=torch.bool)

    class Wide(scene.Scenario):
        def present(self, key: Key, names: Sequence[str]) -> Tensor:
            return torch.ones(len(key), 7, dtype=torch.bool)

    def make(scenario: scene.Scenario | None = None, **options: object) -> ConstellationTasking:
        return ConstellationTasking([Scanner("S0"), Scanner("S1")], scenario, seed=0, backend="eager", **options)

    check_refusals(
        refusal(lambda: make(Nobody()).reset(), ValueError, "Nobody.present(key, names)", "environments [0]"),
        refusal(lambda: make(Wide()).reset(), TypeError, "Wide.present(key, names)", [1, 7], [1, 2]),
        refusal(lambda: make(population=(1, 3)), ValueError, "population", (1, 3), 2),
        refusal(lambda: make(population=3), ValueError, "population=3"),
        refusal(lambda: make(population=(2, 1)), ValueError, "population[1]=1", 2),
        refusal(lambda: make(population=(0, 1)), ValueError, "population[0]=0", 1),
        refusal(lambda: make(population=(1.5, 2)), ValueError, "population[0]", 1.5),
        refusal(lambda: make(population="12"), ValueError, "population", "'12'"),
        refusal(lambda: make(Nobody(), population=(1, 2)), ValueError, "population", (1, 2), "Nobody.present(key, names)"),
    )


# -- 1 to 50 satellites --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fifty() -> ConstellationTasking:
    return scanners(50, 16, population=(1, 50))


def test_fifty_satellites_fly_and_are_planned_for(fifty) -> None:
    td = fifty.reset()
    numbers = fifty.present.sum(1)
    assert numbers.min() >= 1
    assert numbers.max() <= 50
    assert len(numbers.unique()) > 5
    check_env_specs(fifty)
    td = fifty.reset()
    base = TensorDictModule(
        lambda mask: mask.long().argmax(-1), in_keys=[("agents", "action_mask")], out_keys=[("agents", "action")]
    )
    assert not fifty.rollout(2, base, break_when_any_done=False)["next", "agents", "reward"][
        ~fifty.present.unsqueeze(1).expand(-1, 2, -1)
    ].any()
    planner = Rollout(fifty, base=base, horizon=60.0)
    td = fifty.reset()
    td = planner(td)
    assert not (td["agents", "action"] != td["agents", "action_mask"].shape[-1] - 1)[~fifty.present].any()
    assert fifty.step(td)["next", "agents", "reward"].isfinite().all()


def test_fifty_satellites_in_pettingzoo_and_in_pictures() -> None:
    view = PettingZooEnv(scanners(50, 1, population=(1, 50)), continue_action=True, render_mode="rgb_array")
    for _ in range(3):
        observed, infos = view.reset()
        names = [name for name, there in zip(view.core.names, view.core.present[0].tolist(), strict=True) if there]
        assert view.agents == names == list(observed) == list(infos)
        picture = view.render()
        assert picture is not None
        assert picture.shape == (480, 640, 3)
        found = view.step(dict.fromkeys(view.agents, 0))
        assert all(list(part) == names for part in found)
    parallel_api_test(view, 10)


def test_a_constellation_is_recorded_without_the_absent() -> None:
    env = bsk_torch.make(
        "Constellation-v1", num_envs=1, n_satellites=4, n_planes=1, n_targets=300, time_limit=600.0, population=(2, 3)
    )
    found = record(bsk_torch.rule("hasty", env), env, seed=1)
    count = int(env.present.sum())
    assert len(found.names) == len(found.latitude) == len(found.deaths) == count < 4
    assert found.links is None or found.links.shape[1:] == (count, count)
    assert int(found.tasks.satellite.max()) < count


def test_populations_are_trained_and_evaluated(tmp_path) -> None:
    options = dict(as_set=True, n_targets=300, n_satellites=3, n_planes=1, phasing=0, time_limit=600.0, population=(1, 3))
    config = MAPPOConfig(frames=64, num_envs=4, rollout=16, minibatch=16, seconds=None, options=options)
    training = MAPPOTraining(config, tmp_path)
    training.run()
    training._lost = False
    assert training.survived(masks([[1, 1, 0], [1, 1, 0]], [[1, 1, 0], [1, 0, 0]])).tolist() == [[True, False]] * 4
    env = bsk_torch.make("Constellation-v1", num_envs=4, seed=0, **options)
    found = evaluate(shared(training.policy, env), env, seed=5)
    assert found.survival == 1.0
    assert found.returns.isfinite().all()
    assert not any(bool(failed.any()) for failed in found.deaths.values())


def masks(before: list[list[int]], after: list[list[int]]) -> TensorDict:
    """A batch [4, T] of who may act before and after each step."""
    size = [4, len(before)]
    here, then = (TensorDict({"mask": torch.tensor(table).bool().expand(4, -1, -1)}, size) for table in (before, after))
    done = torch.zeros(*size, 1, dtype=torch.bool)
    return TensorDict({"agents": here, "next": TensorDict({"agents": then, "done": done}, size)}, size)


# -- satellites that depend on one another -------------------------------------------------------------------------------------


class Collider(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="r_BN_P", norm=7e6)),)
    action_spec = (act.Drift(duration=100.0),)
    dyn_type = (dyn.ConjunctionDynModel, dyn.BasicDynamicsModel)
    fsw_type = fsw.BasicFSWModel


class Watcher(Collider):
    observation_spec = (*Collider.observation_spec, obs.RelativeProperties(dict(prop="r_DC_N", norm=1e6), chief_name="S2"))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.nightly("eager")
def test_nothing_meets_an_absent_satellite_or_sees_it(backend) -> None:
    """The third satellite would be at the first one's place; the first two meet after four minutes, in the third step."""

    class WithoutThird(scene.UniformNadirScanning):
        def present(self, key: Key, names: Sequence[str]) -> Tensor:
            return torch.tensor([True, True, False]).expand(len(key), -1)

    radius, speed = 7e6, (3.986004418e14 / 7e6) ** 0.5
    far, near = radius * 0.75**0.5, radius * 0.5
    fast, slow = speed * 0.75**0.5, speed * 0.5
    places = [
        ([far, near, 0.0], [-slow, fast, 0.0]),
        ([near, far, 0.0], [fast, -slow, 0.0]),
        ([far, near, 0.0], [-slow, fast, 0.0]),
    ]
    steady = dict(conjunction_radius=2e4, sigma_init=[0.1, 0.0, 0.0], omega_init=[0.0, 0.0, 0.01], wheelSpeeds=[0.0, 1.0, 2.0])
    steady |= dict(storedCharge_Init=2e5, disturbance_vector=[0.0, 0.0, 1e-4])

    def make(kind: type[sats.Satellite], count: int, scenario: scene.Scenario) -> ConstellationTasking:
        satellites = [kind(f"S{k}", steady | dict(rN=r, vN=v)) for k, (r, v) in enumerate(places[:count])]
        when = dict(utc_init="2018 SEP 29 21:00:00.000 (UTC)")
        return ConstellationTasking(satellites, scenario, seed=0, num_envs=2, time_limit=1200.0, world_args=when, backend=backend)

    seen = []
    for env in (make(Watcher, 3, WithoutThird()), make(Collider, 2, scene.UniformNadirScanning())):
        td, steps = env.reset(), []
        for step in range(3):
            td = env.step(choose(env, td, step))["next"]
            agents = td["agents"][:, :2]
            steps.append((agents["observation"], agents["reward"], agents["mask"], td["duration"], td["done"], env.dead[:, :2]))
        seen.append(steps)
    for (observed, *whole), (alone, *two) in zip(*seen, strict=True):
        assert torch.equal(observed[..., :3], alone)
        assert not observed[..., 3:].any()
        assert all(torch.equal(one, other) for one, other in zip(whole, two, strict=True))
    assert seen[0][-1][-1].all(), "the two have met"


def test_inspectors_that_are_absent_see_no_points_and_the_inspected_one_must_be_present() -> None:
    preset = "MultiInspection-v1"

    class WithoutLast(SphericalRSO):
        def present(self, key: Key, names: Sequence[str]) -> Tensor:
            return (torch.arange(len(names)) < len(names) - 1).expand(len(key), -1)

    seen = []
    for options in (dict(scenario=WithoutLast()), dict(scenario=SphericalRSO(), n_inspectors=2)):
        env = bsk_torch.make(preset, num_envs=2, seed=0, **options)
        td = env.reset()
        for _ in range(2):
            for group in env.group_map:
                where = env.full_action_spec[group, "action"]
                real = hasattr(where.space, "low")
                td[group, "action"] = (
                    where.space.low * 0.45 + where.space.high * 0.55 if real else td[group, "action_mask"].long().argmax(-1)
                )
            td = env.step(td)["next"]
        seen.append((env.rewarder.inspected, td["duration"], td["inspector", "reward"][:, :2], env.returns))
    assert all(torch.equal(one, other) for one, other in zip(*seen, strict=True))
    assert seen[0][0].any()
    check_refusals(refusal(lambda: bsk_torch.make(preset, num_envs=16, seed=0, population=(1, 2)).reset(), ValueError, "'RSO'"))
