"""Rewarders of one episode, with data and stores, run for each environment."""

import io
import json
import math
import pickle
from collections import Counter, OrderedDict, defaultdict, deque
from dataclasses import dataclass
from datetime import datetime, timezone
from enum import Enum
from typing import NamedTuple

import numpy as np
import pytest
import torch
from tensordict import TensorDict

import bsk_torch
from bsk_torch import ConstellationTasking, act, comm, data, obs, per_environment, rand, scene
from bsk_torch.bsk_rl import comm as one_comm
from bsk_torch.bsk_rl import data as one
from bsk_torch.bsk_rl import scene as one_scene
from bsk_torch.bsk_rl.comm import CommunicationMethod
from bsk_torch.bsk_rl.data.base import Data, DataStore
from bsk_torch.bsk_rl.data.unique_image_data import UniqueImageData, UniqueImageStore
from bsk_torch.bsk_rl.scene.targets import Target
from bsk_torch.data.pickled import Pickler, Unpickler
from bsk_torch.presets.nadir_scan import ScanningSatellite, scanning_args
from tests.support.episodes import begun
from tests.support.refusals import check_refusals, refusal

pytestmark = pytest.mark.compiled

N = 3


# -- the cloud example of bsk_rl -----------------------------------------------------------------------------------------------


class CloudTargets(scene.UniformTargets):
    def regenerate_targets(self) -> None:
        super().regenerate_targets()
        for target in self.targets:
            target.true_cloud_cover = np.clip(np.random.uniform(0.0, 1.348), 0.0, 1.0)


class CloudData(UniqueImageData):
    def __init__(self, imaged=None, duplicates=0, known=None, covered=None, free=None):
        super().__init__(imaged=imaged, duplicates=duplicates, known=known)
        self.cloud_covered, self.cloud_free = list(set(covered or [])), list(set(free or []))

    def __add__(self, other):
        both = super().__add__(other)
        covered, free = self.cloud_covered + other.cloud_covered, self.cloud_free + other.cloud_free
        return self.__class__(both.imaged, both.duplicates, both.known, covered, free)


class CloudStore(UniqueImageStore):
    data_type = CloudData

    def compare_log_states(self, old_state, new_state):
        imaged = list(super().compare_log_states(old_state, new_state).imaged)
        split = {covered: [t for t in imaged if (t.true_cloud_cover > 0.7) == covered] for covered in (True, False)}
        return CloudData(imaged=imaged, covered=split[True], free=split[False])


class CloudRewarder(one.UniqueImageReward):
    data_store_type = CloudStore

    def calculate_reward(self, new_data_dict):
        reward = {}
        imaged = [target for new in new_data_dict.values() for target in new.cloud_free]
        for name, new in new_data_dict.items():
            reward[name] = 0.0
            for target in new.cloud_free:
                if target not in self.data.imaged:
                    reward[name] += self.reward_fn(target.priority, target.true_cloud_cover, imaged.count(target))
        return reward


class Batched(data.UniqueImageReward):
    """The same for all environments at once."""

    def value(self, target, taken):
        paid = super().value(target, taken) > 0.0
        priority, cover = (self.scenario.look_up(name, target) for name in ("priority", "true_cloud_cover"))
        return torch.where(paid & (cover <= 0.7), priority * (1.0 - cover / 0.7), 0.0)


def linear(priority, cover, count):
    return priority / count * (1 - cover / 0.7)


def imaging(rewarder, scenario=None, **options):
    fixed = dict(num_envs=N, seed=4, time_limit=3000.0, dtype=torch.float64)
    return bsk_torch.make("AEOS-v1", scenario=scenario or CloudTargets(300), rewarder=rewarder, **(fixed | options))


def play(env, steps=6, resume=False):
    """Rewards [N, steps] and last observations of episodes in which the first target is always chosen."""
    rewards = []
    if not resume:
        env.reset()
    for _ in range(steps):
        td = env.step(TensorDict({"action": torch.zeros(env.num_envs, dtype=torch.int64)}, env.batch_size))["next"]
        rewards.append(td["reward"].squeeze(-1))
    return torch.stack(rewards, 1), td["observation"]


@pytest.fixture(scope="module")
def clouds():
    env = imaging(per_environment(CloudRewarder(linear)))
    return env, *play(env)


def test_rewards_are_those_of_the_batched_form(clouds):
    env, rewards, observations = clouds
    batched = imaging(Batched())
    expected, seen = play(batched)
    assert (expected > 0.0).sum() >= 2
    assert torch.allclose(rewards, expected)
    assert torch.allclose(observations, seen)  # so the same targets are hidden
    imaged = batched.rewarder.imaged
    for row, found in enumerate(env.rewarder.data):
        assert sorted(target._place[1] for target in found.imaged) == torch.nonzero(imaged[row]).squeeze(-1).tolist()
        assert len(found.cloud_covered) + len(found.cloud_free) == len(found.imaged)
        assert env.rewarder.rewarder_of(row).cum_reward == {"EO1": pytest.approx(rewards[row].sum().item())}


def test_environments_do_not_depend_on_the_batch_and_begin_anew(clouds):
    _, rewards, _ = clouds
    alone = imaging(per_environment(CloudRewarder(linear)), num_envs=1, env_ids=[1])
    assert torch.allclose(play(alone)[0], rewards[1:2])
    env = imaging(per_environment(CloudRewarder(linear)))
    play(env, 3)
    before = [found.imaged for found in env.rewarder.data]
    env.reset(TensorDict({"_reset": torch.tensor([[False], [True], [False]])}, [N]))
    assert [found.imaged for found in env.rewarder.data] == [before[0], set(), before[2]]
    assert env.rewarder.rewarder_of(1).cum_reward == {"EO1": 0.0}


def test_saved_episodes_go_on(clouds):
    """Stores are saved and restored with the state, into other environments and other rows."""
    env = imaging(per_environment(CloudRewarder(linear)))
    other = imaging(per_environment(CloudRewarder(linear)), num_envs=2, seed=9)
    _, rewards, _ = clouds
    play(env, 3)
    saved = env.get_state()
    other.reset()
    other.restore(saved, torch.tensor([1, 0]), torch.tensor([2, 1]))
    assert {target.name for target in other.rewarder.data_of(1).imaged} == {t.name for t in env.rewarder.data_of(2).imaged}
    assert torch.allclose(play(other, 3, resume=True)[0][[1, 0]], rewards[[2, 1], 3:])
    other.restore(env)  # other.num_envs rows of a live environment
    assert len(other.rewarder.data_of(0).known) == 300


def test_filters_of_stores_hide_opportunities():
    class Some(one.UniqueImageReward):
        def create_data_store(self, satellite):
            super().create_data_store(satellite)
            satellite.add_access_filter(lambda opportunity: opportunity["object"].true_cloud_cover < 0.2, types="target")

    env = begun(imaging(per_environment(Some()), time_limit=300.0))
    allowed = env.satellite.allowed("target")
    assert torch.equal(allowed, env.scenario.target_attribute("true_cloud_cover") < 0.2)


# -- several satellites --------------------------------------------------------------------------------------------------------


class Visits(Data):
    def __init__(self, names=()):
        self.names = set(names)

    def __add__(self, other):
        return Visits(self.names | other.names)


class VisitStore(DataStore):
    data_type = Visits

    def get_log_state(self):
        return self.satellite.simulator.sim_time

    def compare_log_states(self, old_state, new_state):
        assert new_state - old_state == 5.0
        return Visits([f"{self.satellite.name} at {new_state:g}"])


class VisitReward(one.GlobalReward):
    data_store_type = VisitStore
    limit = 99

    def initial_data(self, satellite):
        return Visits([f"{satellite.name} at 0"])

    def calculate_reward(self, new_data_dict):
        return {name: float(len(self.data.names) + len(new.names)) for name, new in new_data_dict.items()}

    def is_terminated(self, satellite):
        return len(satellite.data_store.data.names) >= self.limit


class Brief(ScanningSatellite):
    action_spec = (act.Charge(duration=5.0),)


def crew(rewarder, communicator=None, count=3, **options):
    orbit = dict(oe=rand.random_orbit())
    satellites = [Brief(f"S{k}", scanning_args() | orbit) for k in range(count)]
    fixed = dict(num_envs=2, time_limit=60.0, seed=1, backend="eager", dtype=torch.float64)
    return ConstellationTasking(satellites, scene.UniformNadirScanning(), rewarder, communicator, **(fixed | options))


def step(env):
    shape = env.num_envs, len(env.names)
    action = TensorDict({"action": torch.zeros(shape, dtype=torch.int64)}, shape)
    return env.step(TensorDict({"agents": action}, shape[:1]))["next"]


class Ring(CommunicationMethod):
    """Each satellite tells the next one."""

    def communication_pairs(self):
        satellites = self.satellites
        return [(satellites[k], satellites[k + 1]) for k in range(len(satellites) - 1)]


def test_data_take_one_hop_in_a_step():
    env = begun(crew(per_environment(VisitReward()), per_environment(Ring())))
    assert (step(env)["agents", "reward"] == 4.0).all()
    stores = env.satellites[0].data_store
    mine = [{f"S{k} at 0", f"S{k} at 5"} for k in range(3)]
    for env_stores in (stores[:3], stores[3:]):
        assert [store.data.names for store in env_stores] == [mine[0], mine[0] | mine[1], mine[1] | mine[2]]
    assert env.rewarder.data_of(1).names == mine[0] | mine[1] | mine[2]
    assert env.links[0].tolist() == [[False, True, False], [False, False, True], [False, False, False]]


def test_linked_satellites_get_all_data_and_rewarders_end_episodes():
    env = begun(crew(per_environment(VisitReward()), comm.FreeCommunication()))
    step(env)
    assert [len(store.data.names) for store in env.satellites[0].data_store] == [6] * 6

    class Short(VisitReward):
        limit = 2

    env = begun(crew(per_environment(Short())))
    assert step(env)["terminated"].all()
    env = begun(crew([per_environment(VisitReward()), per_environment(VisitReward())]))
    assert (step(env)["agents", "reward"] == 8.0).all()
    assert [len(part.data) for part in env.rewarder.rewarders] == [2, 2]


class HalfTime(one.ScanningTimeReward):
    def calculate_reward(self, new_data_dict):
        return {name: 0.5 * value for name, value in super().calculate_reward(new_data_dict).items()}


def test_base_classes_reward_as_the_batched_ones():
    """Growth of the store over the rate of the instrument, never less than nothing."""

    def scan(rewarder):
        made = ScanningSatellite("S", scanning_args() | dict(oe=rand.random_orbit(), storageInit=0.0))
        env = bsk_torch.SatelliteTasking(made, scene.UniformNadirScanning(3.0), rewarder, num_envs=2, seed=1, time_limit=1000.0)
        env.reset()
        choices = torch.tensor([[0, 1], [0, 0], [2, 0], [0, 3]])
        steps = [env.step(TensorDict({"action": choice}, [2]))["next", "reward"].squeeze(-1) for choice in choices]
        return torch.stack(steps)

    found, expected = scan(per_environment(HalfTime())), scan(data.ScanningTimeReward())
    assert (expected > 0.0).sum() >= 3
    assert torch.allclose(found, 0.5 * expected)


def test_observations_read_the_store_of_each_satellite():
    class Observer(Brief):
        observation_spec = (
            obs.SatProperties(dict(fn=per_environment(lambda sat: len(sat.data_store.data.names)), name="visits")),
        )

    fixed = dict(num_envs=2, time_limit=60.0, seed=1, backend="eager")
    env = ConstellationTasking(
        [Observer("A", scanning_args())], scene.UniformNadirScanning(), per_environment(VisitReward()), **fixed
    )
    assert (env.reset()["agents", "observation"] == 1.0).all()
    assert (step(env)["agents", "observation"] == 2.0).all()


class Bands(one_scene.UniformTargets):
    """Targets on circles of latitude, one of which is drawn for each episode, with the number of the band."""

    def regenerate_targets(self):
        self.targets, band = [], np.random.randint(1, 5)
        for k in range(self.n_targets):
            angle = 2.0 * np.pi * k / self.n_targets
            place = 6.371e6 * np.array(
                [np.cos(0.2 * band) * np.cos(angle), np.cos(0.2 * band) * np.sin(angle), np.sin(0.2 * band)]
            )
            self.targets.append(Target(f"t{k}", place, 0.5))
            self.targets[-1].band = float(band)


def test_targets_of_one_episode_are_made_for_each_environment():
    env = begun(imaging(data.UniqueImageReward(), per_environment(Bands(40)), num_envs=12, time_limit=300.0))
    band = env.scenario.target_attribute("band")
    assert len(set(band[:, 0].tolist())) == 4
    assert (band == band[:, :1]).all()
    assert torch.allclose(env.scenario.r_LP_P[..., 2], 6.371e6 * torch.sin(0.2 * band))
    alone = begun(imaging(data.UniqueImageReward(), per_environment(Bands(40)), num_envs=1, env_ids=[5], time_limit=300.0))
    assert torch.equal(alone.scenario.r_LP_P[0], env.scenario.r_LP_P[5])


# -- objects in states ---------------------------------------------------------------------------------------------------------


def written(value, classes=()):
    file = io.BytesIO()
    Pickler(file, classes, lambda value: None).dump(value)
    return file.getvalue()


def read(content, classes=()):
    return Unpickler(io.BytesIO(content), classes, str).load()


class Evil:
    """Runs a function where it is unpickled."""

    def __reduce__(self):
        return print, ("executed",)


@pytest.mark.parametrize("payload", [Evil(), [Evil()], pickle.PickleBuffer, math.sin])
def test_pickles_are_not_read(payload, capsys):
    check_refusals(refusal(lambda: read(pickle.dumps(payload), {Evil}), ValueError, "Invalid JSON"))
    assert capsys.readouterr().out == ""


class Color(Enum):
    RED = 1


class Point(NamedTuple):
    x: int
    of: object


@dataclass(frozen=True)
class Frozen:
    a: float
    b: object


class Slotted:
    __slots__ = ("value",)


class Many(list):
    pass


class Loud:
    """Its constructor, and the setter of its property, must never be called."""

    def __init__(self):
        raise AssertionError("the constructor was called")

    path = property(lambda self: None, lambda self, value: pytest.fail("the setter was called"))


def test_plain_data_and_objects_of_listed_classes_come_back():
    loud, slotted, many = object.__new__(Loud), Slotted(), Many([1, 2])
    slotted.value, many.more = {1, (2, 3)}, 5
    vars(loud).update(path="x", me=loud, slotted=slotted, many=many, color=Color.RED, point=Point(1, [loud]))
    array, numbers = np.arange(3.0), [math.inf, -0.0, 10**50, 0.1, 5e-324, 1j, True, None]
    values = {
        "containers": (deque([1, 2], 5), defaultdict(list, a=[1]), OrderedDict(b=1, a=2), Counter("aab"), frozenset({4})),
        "arrays": (array, array, np.float64(0.1), np.array(["x", "yy"]), np.zeros((0, 3))),
        "frozen": Frozen(math.pi, loud),
        "times": datetime(2020, 1, 1, tzinfo=timezone.utc),
        "numbers": numbers,
    }
    kinds = {Loud, Slotted, Many, Color, Point, Frozen}
    found = read(written(values, kinds), kinds)
    assert found["containers"] == values["containers"]
    assert (found["containers"][0].maxlen, found["containers"][1]["z"], list(found["containers"][2])) == (5, [], ["b", "a"])
    first, again, scalar, texts, empty = found["arrays"]
    assert first is again
    assert (first.tolist(), type(scalar), texts.tolist(), empty.shape) == ([0, 1, 2], np.float64, ["x", "yy"], (0, 3))
    assert (found["numbers"], math.copysign(1, found["numbers"][1]), found["times"]) == (numbers, -1.0, values["times"])
    one = found["frozen"].b
    assert vars(one)["path"] == "x"
    assert one.me is one
    assert one.point == Point(1, [one])
    assert (one.slotted.value, one.many, one.many.more, one.color) == ({1, (2, 3)}, [1, 2], 5, Color.RED)


@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16, torch.bool, torch.int64])
def test_tensors_come_back(dtype):
    value = torch.arange(6).view(2, 3).to(dtype)
    assert torch.equal(read(written(value)), value)
    assert read(written(value[:0])).shape == (0, 3)


class Attack:
    """A class that no state of these tests may use."""

    def __init__(self):
        raise AssertionError("the constructor was called")


PARTS = {
    "import": ["object", "subprocess.Popen", None, []],
    "class of the package": ["object", "bsk_torch.bsk_rl.gym.GeneralSatelliteTasking", None, []],
    "class of another module": ["object", f"{__name__}.Attack", None, []],
    "its class": ["object", f"{__name__}.Frozen", None, [["__class__", 1]]],
    "memory": ["array", "<f8", [10**12], ""],
    "pointers": ["array", "|O", [1], "AAAAAAAAAAA="],
    "itself": ["tuple", [[0]]],
    "unhashable": ["set", [[1]]],
    "missing": ["list", [[7]]],
    "kind": ["os.system", "x"],
    "call": ["defaultdict", [], "system"],
}


@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
def test_crafted_objects_are_rejected(part):
    check_refusals(refusal(lambda: read(json.dumps([[0], [part, ["list", []]]]).encode(), {Frozen}), ValueError, "state holds"))


def test_rejects_deep_objects_and_what_is_no_data():
    parts = [["list", [[k + 1]]] for k in range(5000)] + [["list", []]]
    check_refusals(
        refusal(lambda: read(json.dumps([[0], parts]).encode()), ValueError, "recursion"),
        refusal(lambda: saved_by(Model({"scorer": torch.nn.Linear(2, 1)})), TypeError, "Model", "kept.scorer", "numbers"),
    )


class Model(VisitReward):
    """Keeps objects of classes of this module, and one that is no data."""

    def __init__(self, kept):
        super().__init__()
        self.kept, self.named = kept, {"point": Point(1, Color.RED), "many": Many([1])}

    def calculate_reward(self, new_data_dict):
        self.named["point"] = self.named["point"]._replace(x=self.named["point"].x + 1)
        return super().calculate_reward(new_data_dict)


def saved_by(rewarder):
    env = begun(crew(per_environment(rewarder), num_envs=1))
    step(env)
    return env, env.get_state()


def test_objects_of_the_module_of_a_rewarder_are_saved():
    env, state = saved_by(Model({"a": Frozen(1.0, ())}))
    other = begun(crew(per_environment(Model({"a": Frozen(1.0, ())})), num_envs=1))
    other.restore(torch.load(io.BytesIO(_bytes(state.to_dict())), weights_only=True))
    mine = other.rewarder.rewarder_of(0)
    assert (mine.named, mine.kept) == ({"point": Point(2, Color.RED), "many": [1]}, {"a": Frozen(1.0, ())})
    assert isinstance(mine.named["many"], Many)
    assert torch.equal(step(other)["agents", "reward"], step(env)["agents", "reward"])


def _bytes(value):
    file = io.BytesIO()
    torch.save(value, file)
    return file.getvalue()


def test_a_state_with_other_objects_changes_nothing():
    """A state in which an object is of a class that the environment does not list is refused before anything is restored."""
    env, state = saved_by(VisitReward())
    (table,) = [key[:-1] for key in state.keys(True, True) if key[-1] == "bytes"]
    for payload in (json.dumps([[0], [PARTS["class of the package"]]]).encode(), pickle.dumps(Evil())):
        crafted = state.clone()
        row = torch.frombuffer(bytearray(payload), dtype=torch.uint8)
        crafted[table] = TensorDict({"length": torch.tensor([len(row)]), "bytes": row.unsqueeze(0)}, [1])
        with pytest.raises(ValueError, match=r"state holds|Invalid JSON"):
            env.restore(crafted)
    assert torch.equal(env.get_state()[(*table, "bytes")], state[(*table, "bytes")])


# -- what cannot run -----------------------------------------------------------------------------------------------------------


def test_rejects_classes_for_one_episode():
    adapter = "bsk_torch.bsk_rl.data", "per_environment(Mine())", "calculate_reward(before"
    wrong = [
        (data.GlobalReward, dict(data_store_type=VisitStore)),
        (data.GlobalReward, dict(calculate_reward=lambda self, new_data_dict: {})),
        (data.UniqueImageReward, dict(is_truncated=lambda self, satellite: False)),
        (data.UniqueImageReward, dict(initial_data=lambda self, satellite: None)),
        (data.NoReward, dict(create_data_store=lambda self, satellite: None)),
    ]
    check_refusals(
        refusal(lambda base=base, members=members: type("Mine", (base,), members), TypeError, "Mine", *members, *adapter)
        for base, members in wrong
    )


def test_rejects_what_needs_the_adapter_and_what_it_does_not_take():
    class Counting(Ring):
        def reset_post_sim_init(self):
            self.count = 0

    class Moving(Bands):
        def after_step(self, sim_time):
            pass

    hooks = "link_satellites", "reset_post_sim_init", "comm.LOSCommunication"
    check_refusals(
        refusal(lambda: crew(data.NoReward(), Ring()), TypeError, "communicator=", "per_environment(communicator)"),
        refusal(lambda: crew(VisitReward()), TypeError, "rewarder=", "bsk_torch.per_environment(rewarder)"),
        refusal(lambda: imaging(data.NoReward(), Bands(40)), TypeError, "scenario=", "bsk_torch.per_environment(scenario)"),
        refusal(lambda: per_environment(Counting()), TypeError, "Counting()", "reset_post_sim_init"),
        refusal(lambda: per_environment(one_comm.LOSCommunication()), TypeError, *hooks),
        refusal(lambda: per_environment(Moving(40)), TypeError, "after_step", "regenerate_targets()"),
        refusal(lambda: per_environment(scene.UniformTargets(40)), TypeError, "UniformTargets"),
        refusal(lambda: per_environment(data.NoReward()), TypeError, "NoReward"),
        refusal(lambda: per_environment(VisitReward), TypeError, "VisitReward", "parentheses"),
        refusal(lambda: per_environment(3.0), TypeError, "per_environment(3.0)"),
        refusal(lambda: written({"loop": {"run": math.sin}}), TypeError, "loop.run", "sin"),
        refusal(lambda: written({"table": defaultdict(lambda: 1)}), TypeError, "table", "defaultdict", "list, dict"),
    )


def test_rejects_wrong_results_for_one_episode():
    class Listed(comm.CommunicationMethod):
        def communication_pairs(self):
            return [(self.satellites[0], self.satellites[1])]

    class Numbered(Ring):
        def communication_pairs(self):
            return [1, 2]

    class Partial(VisitReward):
        def calculate_reward(self, new_data_dict):
            return {"S0": 1.0}

    class Kept(one.UniqueImageReward):
        def create_data_store(self, satellite):
            super().create_data_store(satellite)
            satellite.add_access_filter(lambda opportunity: True)

    listed, numbered = crew(data.NoReward(), Listed()), crew(data.NoReward(), per_environment(Numbered()))
    partial, kept = crew(per_environment(Partial())), imaging(per_environment(Kept()))
    for env in (listed, numbered, partial):
        env.reset()
    play(kept, 1)
    method = "bsk_torch.bsk_rl.comm", "per_environment(method)"
    check_refusals(
        refusal(lambda: step(listed), AttributeError, "Listed.satellites", *method),
        refusal(lambda: step(numbered), TypeError, "Numbered.communication_pairs()", [1, 2], "(sender, receiver)"),
        refusal(lambda: step(partial), TypeError, "Partial.calculate_reward(new_data_dict)", ["S0", "S1", "S2"]),
        refusal(lambda: kept.get_state(), TypeError, "Kept", "function", "class"),
    )
