"""What a constellation promises: specs, independence of batch and order, and one satellite as if it were alone."""

import math
import pickle

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import check_env_specs, check_marl_grouping

from bsk_torch import NO_ACTION, ConstellationTasking, SatelliteTasking, act, comm, data, formations, obs, rand, sats, scene
from bsk_torch.sim import dyn, fsw
from bsk_torch.sim.access.lookahead import LookAhead
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

BACKENDS = ["eager", "compiled"]
LIMIT = 900.0


class Linked(dyn.ImagingDynModel, dyn.LOSCommDynModel):
    pass


class Imager(sats.ImagingSatellite):
    observation_spec = (
        obs.SatProperties(dict(prop="storage_level_fraction"), dict(prop="omega_BP_P", norm=0.03), dict(prop="battery_charge")),
        obs.OpportunityProperties(dict(prop="priority"), dict(prop="target_angle"), n_ahead_observe=3),
        obs.Time(),
    )
    action_spec = (act.Charge(duration=47.0), act.Drift(duration=31.0), act.Image(n_ahead_image=3))
    dyn_type = Linked
    fsw_type = fsw.ImagingFSWModel


class RelayDynModel(dyn.BasicDynamicsModel, dyn.LOSCommDynModel):
    pass


class Relay(sats.Satellite):
    observation_spec = (obs.SatProperties(dict(prop="battery_charge_fraction")), obs.Time())
    action_spec = (act.Charge(duration=40.0), act.Drift(duration=25.0))
    dyn_type = RelayDynModel


ARGS = dict(
    imageAttErrorRequirement=0.05, imageRateErrorRequirement=0.05, u_max=0.4, imageTargetMinimumElevation=math.radians(20.0)
)


def imagers(count: int, **changes: object) -> list[Imager]:
    arguments = {**ARGS, **changes}
    return [Imager(f"EO{k}", arguments, may_see_nothing=True) for k in range(count)]


def build(satellites: list[sats.Satellite], num_envs: int = 3, **options: object) -> ConstellationTasking:
    given: dict[str, object] = dict(
        scenario=scene.UniformTargets(300), rewarder=data.UniqueImageReward(), time_limit=LIMIT, seed=3
    )
    return ConstellationTasking(satellites, **{"num_envs": num_envs, **given, **options})  # type: ignore[arg-type]


def mixed(**options: object) -> ConstellationTasking:
    one, two = imagers(2)
    return build([one, Relay("Relay1"), two], **options)


def chosen(env: ConstellationTasking, td: TensorDict, step: int, rows: Tensor | None = None) -> TensorDict:
    """Actions that depend on satellite, episode and step only; the busy go on."""
    td = td.clone()
    for group in env.groups:
        mask = td[group.name, "action_mask"]
        envs = torch.arange(len(mask)) if rows is None else rows
        sizes = [env.fleet.satellites[t].actions.n_actions + 1 for t in group.types]
        columns = []
        for m, part in enumerate(mask.split(sizes, -1)):
            want = (envs[:, None] * 7 + group.members[:, m] * 3 + step) % (sizes[m] - 1)
            columns.append(torch.where(part[..., -1], sizes[m] - 1, want))
        td[group.name, "action"] = columns[0] if len(columns) == 1 else torch.stack(columns, -1)
    return td


def play(env: ConstellationTasking, steps: int, rows: Tensor | None = None) -> list[TensorDict]:
    td, seen = env.reset(), []
    for step in range(steps):
        td = env.step(chosen(env, td, step, rows))["next"].clone()
        seen.append(td)
    return seen


def assert_equal(a: TensorDict, b: TensorDict, *leave: str) -> None:
    keys = [key for key in a.keys(True, True) if not (set(key if isinstance(key, tuple) else (key,)) & set(leave))]
    assert keys
    for key in keys:
        assert torch.equal(a[key], b[key]), key


GROUPS = {
    "one": lambda: build(imagers(3), sat_arg_randomizer=formations.train_args(2.0)),
    "two": mixed,
    "meta": lambda: build(imagers(4), meta_agent_groupings={"pair": ["EO3", "EO1"]}),
    "mixed meta": lambda: mixed(meta_agent_groupings={"pair": ["EO0", "Relay1"]}),
    "joint": lambda: mixed(joint=True),
}


@pytest.mark.parametrize("kind", GROUPS)
def test_specs(kind: str) -> None:
    env = GROUPS[kind]()
    check_env_specs(env)
    if kind != "joint":
        check_marl_grouping(env.group_map, [agent for agents in env.group_map.values() for agent in agents])


def test_groups_and_their_shapes() -> None:
    env = mixed(meta_agent_groupings={"pair": ["EO0", "Relay1"]})
    assert env.group_map == {"imager_and_relay": ["pair"], "imager": ["EO1"]}
    td = env.reset()
    imager = build(imagers(1)).reset()["agents", "observation"].shape[-1]
    relay = mixed().reset()["relay", "observation"].shape[-1]
    assert td["imager_and_relay", "observation"].shape == (3, 1, imager + relay)
    assert td["imager_and_relay", "action_mask"].shape == (3, 1, 6 + 3)
    assert env.full_action_spec["imager_and_relay", "action"].shape == (3, 1, 2)
    assert env.full_action_spec["imager", "action"].shape == (3, 1)


class FarSighted(Imager):
    action_spec = (act.Charge(duration=47.0), act.Image(n_ahead_image=5))


@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1), (2, 0, 1)])
def test_several_imagers_of_one_type_beside_another_type(order: tuple[int, ...]) -> None:
    """Satellites of both types are paid for images of targets that neither has imaged before."""
    one, two = imagers(2)
    satellites = [(one, two, FarSighted("EO2", ARGS, may_see_nothing=True))[k] for k in order]
    env = build(satellites, time_limit=3000.0, communicator=comm.FreeCommunication())
    assert sorted(len(group.agents) for group in env.groups) == [1, 2]
    paid, td = torch.zeros(3, 3, dtype=torch.float64), env.reset()
    for step in range(40):
        td = env.step(chosen(env, td, step))["next"].clone()
        for group in env.groups:
            paid[:, group.members.squeeze(-1)] += td[group.name, "reward"].squeeze(-1)
    worth = (env.rewarder.imaged * env.scenario.priority).sum(1)
    assert (paid.amax(0) > 0.0).all()
    torch.testing.assert_close(paid.sum(1), worth, rtol=1e-6, atol=0)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.nightly("eager")
def test_a_constellation_of_one_is_satellite_tasking(backend: str) -> None:
    options = dict(num_envs=4, time_limit=LIMIT, seed=5, backend=backend)
    options |= dict(max_step_duration=30.0) if backend == "eager" else {}  # its ticks take milliseconds each
    alone = SatelliteTasking(imagers(1)[0], scene.UniformTargets(300), data.UniqueImageReward(), **options)
    many = build(imagers(1), **options)
    a, b = alone.reset(), many.reset()
    for step in range(14 if backend == "compiled" else 4):
        action = (torch.arange(4) + step) % 5
        a = alone.step(a.set("action", action))["next"].clone()
        b = many.step(b.set(("agents", "action"), action.unsqueeze(1)))["next"].clone()
        for key in ("observation", "reward"):
            assert torch.equal(a[key], b["agents", key].squeeze(1)), (step, key)
        assert torch.equal(a["duration"], b["duration"])
        assert torch.equal(a["done"], b["done"])
        if bool(a["done"].any()):
            rows = a["done"].clone()
            a, b = alone.reset(a.set("_reset", rows)), many.reset(b.set("_reset", rows))


def test_satellites_that_share_nothing_are_alone() -> None:
    """Two imagers with targets of their own, in fixed intervals, fly like two environments of one satellite each."""
    options = dict(max_step_duration=50.0, time_limit=LIMIT, seed=1)
    world = {"utc_init": "2015 JUN 03 04:05:06.000 (UTC)"}
    pair = [Imager(f"EO{k}", {**ARGS, "oe": rand.random_orbit(i=40.0 + 30.0 * k)}, variable_interval=False) for k in range(2)]
    for satellite in pair:
        satellite.may_see_nothing = True
    targets = scene.UniformTargets(200).draw(rand.first_key(1))
    places = scene.Targets(targets["target_r_LP_P"][0], targets["target_priority"][0])
    both = ConstellationTasking(pair, places, data.NoReward(), num_envs=2, world_args=world, **options)
    td = both.reset()
    drawn = both.satellites[0].sat_args
    singles = []
    for k in range(2):
        args = {
            name: rand.per_env(drawn[name][k::2])
            for name in ("oe", "sigma_init", "omega_init", "wheelSpeeds", "storedCharge_Init")
        }
        satellite = Imager("EO", {**ARGS, **args}, variable_interval=False, may_see_nothing=True)
        singles.append(SatelliteTasking(satellite, places, data.NoReward(), num_envs=2, world_args=world, **options))
    alone = [env.reset() for env in singles]
    for step in range(15):
        action = torch.tensor([[0, 2], [3, 1]]) + step % 2
        td = both.step(td.set(("agents", "action"), action))["next"].clone()
        alone = [
            env.step(a.set("action", action[:, k]))["next"].clone() for k, (env, a) in enumerate(zip(singles, alone, strict=True))
        ]
        for k in range(2):
            assert torch.equal(td["agents", "observation"][:, k], alone[k]["observation"]), (step, k)


@pytest.mark.parametrize("kind", ["one", "two"])
def test_batch_and_order_do_not_matter(kind: str) -> None:
    def made(**options: object) -> ConstellationTasking:
        if kind == "two":
            return mixed(communicator=comm.LOSCommunication(), **options)
        return build(
            imagers(3), sat_arg_randomizer=formations.walker_delta_args(3), communicator=comm.LOSCommunication(), **options
        )

    whole = play(made(num_envs=5), 20)
    rows = torch.tensor([3, 0])
    some = play(made(num_envs=2, env_ids=rows), 20, rows)
    assert len(whole) == 20
    for a, b in zip(whole, some, strict=True):
        assert_equal(a[rows], b)


@pytest.mark.parametrize("kind", ["one", "two"])
@pytest.mark.nightly("one")
def test_back_ends_agree(kind: str) -> None:
    """Ends of steps, tasks and rewards are the same; observations within the difference of the two orbit solvers."""
    eager, compiled = (play(GROUPS_OF[kind](backend), 10) for backend in ("eager", "compiled"))
    assert len(eager) == 10
    for a, b in zip(eager, compiled, strict=True):
        for key in a.keys(True, True):
            if a[key].dtype.is_floating_point and "observation" in key:
                torch.testing.assert_close(a[key], b[key], atol=2e-5, rtol=0)
            elif a[key].dtype.is_floating_point:
                torch.testing.assert_close(a[key], b[key], atol=1e-6, rtol=0)
            else:
                assert torch.equal(a[key], b[key]), key


GROUPS_OF = {
    "one": lambda backend: build(imagers(3), backend=backend, sat_arg_randomizer=formations.train_args(4.0)),
    "two": lambda backend: mixed(backend=backend, communicator=comm.LOSCommunication()),
}


@pytest.mark.parametrize("go_on", [5, NO_ACTION])
def test_steps_end_with_the_first_task(go_on: int) -> None:
    env = build(imagers(2), num_envs=1)
    td = env.reset()
    assert td["agents", "requires_retasking"].all()
    td = env.step(td.set(("agents", "action"), torch.tensor([[0, 1]])))["next"].clone()
    assert td["duration"].item() == 31.0
    assert td["agents", "requires_retasking"].flatten().tolist() == [False, True]
    assert td["agents", "action_mask"][0, 0].tolist() == [False] * 5 + [True]
    assert not td["agents", "action_mask"][0, 1, -1]
    td = env.step(td.set(("agents", "action"), torch.tensor([[go_on, 1]])))["next"].clone()
    assert td["duration"].item() == 16.0
    assert td["agents", "requires_retasking"].flatten().tolist() == [True, False]


def test_observed_windows_are_not_searched_again_by_the_next_action(monkeypatch: pytest.MonkeyPatch) -> None:
    env = build(imagers(2))
    td, asked = env.reset(), []
    ask = LookAhead.next_windows
    monkeypatch.setattr(LookAhead, "next_windows", lambda self, *query: asked.append(query[0]) or ask(self, *query))
    for step in range(4):
        td = env.step(chosen(env, td, step))["next"]
    assert asked == 4 * ["target"]


def test_busy_satellites_are_retasked_and_fixed_intervals_end_no_steps() -> None:
    env = build(imagers(2), num_envs=1)
    td = env.step(env.reset().set(("agents", "action"), torch.tensor([[0, 1]])))["next"].clone()
    td = env.step(td.set(("agents", "action"), torch.tensor([[1, 0]])))["next"].clone()
    assert td["duration"].item() == 31.0  # a new drift, instead of 16 s that were left of charging
    assert td["agents", "requires_retasking"].flatten().tolist() == [True, False]
    satellites = imagers(2)
    satellites[0] = Imager("EO0", ARGS, variable_interval=False, may_see_nothing=True)
    env = build(satellites, num_envs=1)
    groups = [group.name for group in env.groups]
    td = env.reset()
    td[groups[0], "action"], td[groups[1], "action"] = torch.tensor([[1]]), torch.tensor([[0]])
    td = env.step(td)["next"].clone()
    assert td["duration"].item() == 47.0
    assert td[groups[0], "requires_retasking"].item()


def test_an_idle_satellite_without_a_task_is_named_once(caplog: pytest.LogCaptureFixture) -> None:
    env = build(imagers(2), num_envs=2)
    td = env.reset()
    for _ in range(2):
        td = env.step(td.set(("agents", "action"), torch.tensor([[0, 5], [0, 1]])))["next"].clone()
    said = [record.message for record in caplog.records if "requires retasking" in record.message]
    assert said == ["satellite EO1 of environment 0 requires retasking but received no task; its mode continues"]
    assert td["duration"].tolist() == [[47.0], [31.0]]


def mortal(**options: object) -> ConstellationTasking:
    """The middle one of three has a battery for two minutes."""
    satellites = imagers(3, storedCharge_Init=250_000.0, batteryStorageCapacity=288_000.0)
    weak = {**satellites[1].sat_args_generator, "storedCharge_Init": 600.0, "basePowerDraw": -5.0, "panelArea": 0.01}
    satellites[1] = Imager("EO1", weak, may_see_nothing=True)
    return build(satellites, failure_penalty=-3.0, **options)


def test_a_dead_satellite_leaves_and_the_others_go_on() -> None:
    env = mortal(num_envs=2)
    td, died, after = env.reset(), 0, 0
    for step in range(60):
        before = td["agents", "mask"]
        td = env.step(chosen(env, td, step))["next"].clone()
        alive, reward = td["agents", "mask"], td["agents", "reward"].squeeze(-1)
        gone = before & ~alive
        died += int(gone.sum())
        assert torch.all(reward[gone] < -1.9)  # the penalty, and at most an image
        assert torch.all(reward[~before] == 0.0)
        assert torch.all(td["agents", "observation"][~before] == 0.0)
        assert torch.all(td["agents", "action_mask"][~alive].sum(-1) == 1)
        assert not td["agents", "requires_retasking"].squeeze(-1)[~alive].any()
        if bool((~alive).any()) and not bool(td["done"].any()):
            after += 1
            lost = ~alive.all(1)
            assert torch.all(td["agents", "requires_retasking"][lost].any(1))  # steps end with tasks of the living
        if bool(td["done"].all()):
            break
    assert died == 2
    assert after > 5
    assert td["truncated"].all()
    assert not td["terminated"].any()


def test_episodes_end_with_the_last_satellite_and_begin_with_everybody() -> None:
    satellites = imagers(2, storedCharge_Init=200.0, batteryStorageCapacity=30_000.0, basePowerDraw=-20.0, panelArea=0.01)
    env = build(satellites, num_envs=1)
    seen = play(env, 3)
    first = next(td for td in seen if bool(td["done"].any()))
    assert first["terminated"].all()
    assert not first["agents", "mask"].any()
    assert torch.all(first["agents", "reward"] == -1.0)
    env = mortal(num_envs=2)
    td = env.reset()
    state = env.get_state()
    while bool(td["agents", "mask"].all()):
        td = env.step(chosen(env, td, 0))["next"].clone()
    assert env.satellites[0].removed.any()
    again = env.reset(td.set("_reset", torch.tensor([[True], [False]])))
    assert again["agents", "mask"][0].all()
    assert not env.satellites[0].removed[:3].any()
    env.reset(TensorDict({"state": state}, [2]), set_state=True)
    assert not env.satellites[0].removed.any()


def test_joint_pays_for_the_dead_and_ends() -> None:
    env = mortal(num_envs=1, joint=True)
    td = env.reset()
    assert td["observation"].shape == (1, env.observation_spec["observation"].shape[-1])
    for _ in range(10):
        action = torch.where(td["members_require_retasking"], 1, NO_ACTION)
        td = env.step(td.set("action", action))["next"].clone()
        if bool(td["done"].any()):
            break
    assert td["terminated"].all()
    assert td["reward"].item() == -3.0


def test_members_of_meta_agents_that_are_busy_keep_their_tasks_on_request() -> None:
    durations = {}
    for only_idle in (False, True):
        env = build(
            imagers(2), num_envs=1, meta_agent_groupings={"pair": ["EO0", "EO1"]}, only_retask_idle_meta_agent_members=only_idle
        )
        td = env.step(env.reset().set(("agents", "action"), torch.tensor([[[0, 1]]])))["next"].clone()
        assert td["agents", "members_require_retasking"].flatten().tolist() == [False, True]
        td = env.step(td.set(("agents", "action"), torch.tensor([[[0, 0]]])))["next"].clone()
        durations[only_idle] = td["duration"].item()
    assert durations == {False: 47.0, True: 16.0}


def test_only_those_who_decide_observe_on_request() -> None:
    env = build(imagers(3), generate_obs_retasking_only=True)
    played = play(env, 12)
    assert len(played) == 12
    for td in played:
        idle = td["agents", "requires_retasking"].squeeze(-1)
        assert torch.all(td["agents", "observation"][~idle] == 0.0)
        assert torch.all(td["agents", "observation"][idle].abs().sum(-1) > 0.0)


def test_partial_steps_and_resets_touch_only_their_rows() -> None:
    env, twin = build(imagers(2), num_envs=3), build(imagers(2), num_envs=3)
    a, b = env.reset(), twin.reset()
    for step in range(8):
        a = env.step(chosen(env, a, step))["next"].clone()
        partial = chosen(twin, b, step).set("_step", torch.tensor([True, step % 2 == 0, True]))
        b = twin.step(partial)["next"].clone()
        assert_equal(a[[0, 2]], b[[0, 2]])
    untouched = b[2].clone()
    b = twin.reset(b.set("_reset", torch.tensor([[True], [False], [False]])))
    assert torch.equal(b["agents", "observation"][2], untouched["agents", "observation"])
    assert twin.fleet.ticks[0] == 0
    assert twin.fleet.ticks[2] > 0


def test_states_can_be_saved_in_the_middle_of_tasks() -> None:
    env = mixed(communicator=comm.LOSCommunication())
    td = play(env, 6)[-1]
    state = env.get_state()

    def onwards(env: ConstellationTasking, td: TensorDict) -> list[TensorDict]:
        seen = []
        for step in range(8):
            td = env.step(chosen(env, td, step))["next"].clone()
            seen.append(td)
        return seen

    first = onwards(env, td)
    env.reset(TensorDict({"state": state}, [3]), set_state=True)
    assert len(first) == 8
    for a, b in zip(first, onwards(env, td), strict=True):
        assert_equal(a, b)


@pytest.mark.parametrize("count", [1, 2])
def test_images_of_the_same_target_in_one_step_share_its_reward(count: int) -> None:
    """Two satellites on one orbit, side by side, take the same picture in the same tick."""
    args = {
        **ARGS,
        "oe": rand.random_orbit(i=50.0, Omega=10.0, omega=0.0, f=20.0),
        "sigma_init": [0.1, 0.2, 0.3],
        "omega_init": [0.0] * 3,
    }
    args |= {"wheelSpeeds": [0.0] * 3, "disturbance_vector": [0.0] * 3}
    env = build([Imager(f"EO{k}", args, may_see_nothing=True) for k in range(count)], num_envs=2)
    td = env.reset()
    paid = torch.zeros(2, count, 1)
    for _ in range(3):
        td = env.step(td.set(("agents", "action"), torch.full((2, count), 2)))["next"].clone()
        paid += td["agents", "reward"]
    images = env.counts()["imaged"]
    assert torch.all(images > 0)
    worth = (env.scenario.priority * env.rewarder.imaged).sum(1)
    torch.testing.assert_close(paid.sum((1, 2)).double(), worth, rtol=1e-6, atol=0)
    assert torch.all(env.rewarder.counts()["duplicates"] == 0)
    if count == 2:
        assert torch.equal(paid[:, 0], paid[:, 1])


@pytest.mark.parametrize(("method", "knows"), [(comm.NoCommunication, False), (comm.FreeCommunication, True)])
def test_images_of_others_hide_targets_if_told(method: type[comm.CommunicationMethod], knows: bool) -> None:
    env = build(imagers(2), num_envs=2, communicator=method(), sat_arg_randomizer=formations.train_args(1.0))
    play(env, 30)
    known, imaged = env.rewarder.known, env.rewarder.imaged
    assert torch.equal(known.any(1), imaged)
    assert imaged.any()
    assert bool((known.all(1) == imaged).all()) == knows


def test_users_communication() -> None:
    class OneWay(comm.CommunicationMethod):
        """The first tells the second."""

        def communication_pairs(self) -> Tensor:
            pairs = torch.zeros(self.fleet.num_envs, 2, 2, dtype=torch.bool)
            pairs[:, 0, 1] = True
            return pairs

    env = build(imagers(2), num_envs=2, communicator=OneWay(), sat_arg_randomizer=formations.train_args(1.0))
    play(env, 30)
    first, second = env.rewarder.known.unbind(1)
    assert torch.equal(second, env.rewarder.imaged)
    assert first.sum() < second.sum()


class Blind(Imager):
    dyn_type = dyn.ImagingDynModel


def test_rejects_wrong_satellites_and_agents():
    meta = lambda groupings: build(imagers(2), meta_agent_groupings=groupings)
    named = [Imager(f"EO{k}", ARGS, obs_type=dict, may_see_nothing=True) for k in range(2)]
    joint = lambda: build(imagers(2), joint=True, meta_agent_groupings={"a": ["EO0"]})
    check_refusals(
        refusal(lambda: build([]), ValueError, "satellites", "empty"),
        refusal(lambda: build([*imagers(1), *imagers(1)]), ValueError, "satellites", ["EO0"]),
        refusal(lambda: build([Imager]), TypeError, "satellites", "Imager", "parentheses"),
        refusal(lambda: meta({"pair": ["EO0", "EO7"]}), ValueError, "meta_agent_groupings['pair']", "'EO7'", "'EO0'", "'EO1'"),
        refusal(lambda: meta({"a": ["EO0"], "b": ["EO0"]}), ValueError, "meta_agent_groupings", "'EO0'", "'a'", "'b'"),
        refusal(lambda: meta({"a": []}), ValueError, "meta_agent_groupings['a']", "[]"),
        refusal(lambda: build(named, meta_agent_groupings={"a": ["EO0", "EO1"]}), ValueError, "'a'", "EO0", "obs_type"),
        refusal(joint, ValueError, "joint=True", "meta_agent_groupings"),
        refusal(lambda: build(imagers(2), group_map={"x": ["EO0"]}), ValueError, "group_map", ["EO1"]),
        refusal(lambda: mixed(group_map={"all": ["EO0", "EO1", "Relay1"]}), ValueError, "group_map['all']", "'EO0'", "'Relay1'"),
    )


def test_rejects_wrong_options():
    unseen = lambda: build([Blind(f"B{k}", ARGS) for k in range(2)], communicator=comm.LOSCommunication())
    randomized = lambda randomizer, count=1: build(imagers(count), sat_arg_randomizer=randomizer)
    check_refusals(
        refusal(unseen, TypeError, "LOSCommDynModel", "B0", "ImagingDynModel"),
        refusal(lambda: build([Relay("A"), Relay("B")], scenario=None), ValueError, "UniqueImageReward", "targets"),
        refusal(lambda: build([Relay("A")], rewarder=None), ValueError, "scene.UniformTargets", "sats.ImagingSatellite", "Relay"),
        refusal(lambda: randomized(formations.walker_delta_args(3), 4), ValueError, "n_planes=3", [1, 2, 4]),
        refusal(lambda: randomized(3), TypeError, "sat_arg_randomizer=3"),
        refusal(lambda: randomized(lambda _: {"EO9": {"mass": 1.0}}), ValueError, "sat_arg_randomizer", "'EO9'", "'EO0'"),
        refusal(lambda: randomized(lambda _: {"EO0": {"masss": 1.0}}), KeyError, "sat_arg_randomizer", "'masss'", "'mass'"),
        refusal(lambda: build(imagers(1), world_args={"utcinit": "x"}), KeyError, "world_args", "'utcinit'", "'utc_init'"),
        refusal(lambda: build(imagers(1), num_envs=0), ValueError, "num_envs=0"),
    )


def test_rejects_wrong_actions() -> None:
    env = build(imagers(2), num_envs=2, backend="eager")
    env.reset()
    act = lambda action: env.play([action], torch.ones(2, dtype=torch.bool))
    check_refusals(
        refusal(lambda: act(torch.tensor([[0, 6], [0, 0]])), ValueError, "action 6", "EO1", "environment 0", "0: action_charge"),
        refusal(lambda: act(torch.zeros(2, 2)), TypeError, "action", "torch.float32", "torch.int64"),
        refusal(lambda: act(torch.zeros(2, dtype=torch.long)), ValueError, "action", [2], [2, 2]),
    )


def test_a_users_randomizer_is_asked_for_every_episode() -> None:
    asked = []

    def orbits(satellites: list[sats.Satellite]) -> dict[sats.Satellite, dict[str, object]]:
        asked.append([satellite.name for satellite in satellites])
        return {satellite: {"mass": 100.0 + len(asked) + 10.0 * k} for k, satellite in enumerate(satellites)}

    env = build(imagers(2), num_envs=2, sat_arg_randomizer=orbits)
    asked.clear()
    env.reset()
    assert asked == [["EO0", "EO1"]] * 2
    assert env.satellites[0].sat_args["mass"].tolist() == [101.0, 111.0, 102.0, 112.0]
    env.reset()
    assert env.satellites[0].sat_args["mass"].tolist() == [103.0, 113.0, 104.0, 114.0]


def test_joint_observes_only_those_who_need_a_task_on_request() -> None:
    env = mixed(num_envs=1, joint=True, generate_obs_retasking_only=True)
    td = env.reset()
    assert (td["observation"] != 0.0).any()
    td = env.step(td.set("action", torch.tensor([[0, 1, 0]])))["next"]
    assert td["members_require_retasking"].tolist() == [[False, True, False]]  # the relay drifts for 25 s
    imager = len(env.satellites[0].observation_description)
    relay = len(env.satellites[1].observation_description)
    first, second, third = td["observation"].split([imager, relay, imager], -1)
    assert (second != 0.0).any()
    assert not first.any()
    assert not third.any()


DEAD_FROM_THE_START = {
    ((None, 1, None), (0, 2)): [False, True, False],
    ((None, 0, 1), (0,)): [False, False, True],
    ((1, None, None), (2,)): [True, True, False],
    ((2, 1, None), (0,)): [False, True, True],
    ((2, 1, None), (0, 2)): [False, True, False],
}
"""Who requires a task, and is not zeros, after bsk_rl's first step, by the actions of three satellites and who has no charge."""


@pytest.mark.parametrize(("actions", "dead"), DEAD_FROM_THE_START)
def test_the_dead_require_no_task_in_the_step_that_ends_a_joint_episode(
    actions: tuple[int | None, ...], dead: tuple[int, ...]
) -> None:
    class Three(sats.Satellite):
        observation_spec = (obs.SatProperties(dict(prop="r_BN_N", norm=7e6)),)
        action_spec = (act.Drift(duration=60.0), act.Drift(duration=33.0, name="short"), act.Charge(duration=47.0))

    satellites = [Three(f"s{k}", dict(storedCharge_Init=0.0) if k in dead else {}) for k in range(3)]
    env = build(satellites, num_envs=2, scenario=None, rewarder=None, joint=True, generate_obs_retasking_only=True)
    td = env.reset()
    td["action"] = torch.tensor([NO_ACTION if choice is None else choice for choice in actions]).expand(2, 3)
    td = env.step(td.set("_step", torch.tensor([True, False])))["next"]
    assert bool(td["terminated"][0])
    assert env.requires_retasking.tolist() == [DEAD_FROM_THE_START[actions, dead], [True, True, True]]
    assert (td["observation"][0].view(3, -1) != 0.0).any(-1).tolist() == DEAD_FROM_THE_START[actions, dead]


def test_a_constellation_can_be_pickled_in_the_middle_of_an_episode() -> None:
    env = mixed(communicator=comm.LOSCommunication(), sat_arg_randomizer=formations.train_args(3.0))
    td = play(env, 5)[-1]
    twin = pickle.loads(pickle.dumps(env))
    for step in range(4):
        a, b = (each.step(chosen(each, td, step))["next"].clone() for each in (env, twin))
        assert_equal(a, b)
        td = a


def test_pools_of_prepared_episodes_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def episodes() -> list[TensorDict]:
        env = mixed(num_envs=4, time_limit=120.0, communicator=comm.FreeCommunication())
        td, seen = env.reset(), []
        for step in range(25):
            played, td = env.step_and_maybe_reset(chosen(env, td, step))
            seen.append(played["next"].clone())
        assert torch.all(env.episode > 1)
        return seen

    several = episodes()  # a small batch prepares several episodes, from the second one on
    for prepared in (0, 1):
        monkeypatch.setattr("bsk_torch.env.assembly.fleets.FleetBuilder.prepared", prepared)
        one_by_one = episodes()
        assert len(one_by_one) == len(several) == 25
        for a, b in zip(several, one_by_one, strict=True):
            assert_equal(a, b)
