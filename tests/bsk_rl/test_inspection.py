"""Inspection of an RSO in the drop-in, against recorded episodes of bsk_rl, and its rewards with flags that the tests set."""

from types import SimpleNamespace

import numpy as np
import pytest

from bsk_torch.bsk_rl.data import RSOInspectionReward
from bsk_torch.bsk_rl.data.rso_inspection import RSOInspectionData
from bsk_torch.bsk_rl.scene import SphericalRSO
from bsk_torch.bsk_rl.sim.inspection import Found, Inspection
from bsk_torch.sim import fsw
from bsk_torch.tasks.inspection import RSODynModel, RSOInspectorDynModel, RSOInspectorFSWModel
from tests.bsk_rl.fakes import Fake, begin, step
from tests.support.refusals import check_refusals, refusal
from tests.tasks.inspection.replay import Episodes, environment, load, replay


def one_episode(case, k):
    """Return one episode of a recording."""
    whole = load(case)
    arrays = {name: [rows[k]] for name, rows in whole.arrays.items()}
    return Episodes([whole.initial[k]], arrays, whole.bonus_time[k : k + 1], whole.death[k : k + 1], whole.names)


@pytest.mark.compiled
def test_points_are_found_in_the_steps_of_the_recordings():
    for case in ("fine", "one", "three"):
        recorded = one_episode(case, 0)
        env = environment(recorded)
        points = SphericalRSO(**recorded.initial[0]["scenario"]).generate_points()
        inspectors = [(1, row) for row in range(len(recorded.initial[0]["sats"]) - 1)]
        inspection = Inspection(env.fleet, (0, 0), inspectors, points)
        known = np.zeros((len(inspectors), 2, len(points)), dtype=bool)
        for k, _, _ in replay(env, recorded):
            known |= np.array([inspection.take(place) for place in inspectors])
            np.testing.assert_array_equal(known[:, 0], recorded.arrays["inspected"][0][k + 1] > 0, case)
            np.testing.assert_array_equal(known[:, 1], recorded.arrays["illuminated"][0][k + 1] > 0, case)
            assert not np.any([inspection.take(place) for place in inspectors]), f"found twice in {case}"
        assert known[:, 0].any()
        assert not known[:, 1].all()
        inspection.stop()
        assert inspection._look not in env.fleet.flight_observers


# -- rewards ---------------------------------------------------------------------------------------------------------------------


class Target(Fake):
    dyn_type, fsw_type = RSODynModel, fsw.FSWModel


class Inspector(Fake):
    dyn_type, fsw_type = RSOInspectorDynModel, RSOInspectorFSWModel

    @property
    def fsw(self):
        return object.__new__(RSOInspectorFSWModel)


class FakeInspection:
    """Gives what a test has set."""

    def __init__(self, fleet, rso, inspectors, points):
        self.places, self.points, self.next = (rso, list(inspectors)), len(points), {}

    def take(self, inspector):
        seen, lit = self.next.pop(inspector, ([], []))
        return Found(*(np.isin(np.arange(self.points), flags) for flags in (seen, lit)))

    def stop(self):
        self.next = None


@pytest.fixture
def crew(monkeypatch):
    """Return an RSO of ten points with two inspectors, and a function that plays a step."""
    monkeypatch.setattr("bsk_torch.bsk_rl.scene.rso_points.Inspection", FakeInspection)
    simulator = SimpleNamespace(sim_time=0.0, fleet=None)
    satellites = [Target("RSO", simulator, core_row=(0, 0))]
    satellites += [Inspector(f"I{k}", simulator, core_row=(1, k)) for k in range(2)]
    type(satellites[0]).dynamics = property(lambda self: object.__new__(RSODynModel))
    scenario = SphericalRSO(n_points=10)
    scenario.link_satellites(satellites)

    def start(**options):
        rewarder = RSOInspectionReward(**options)
        rewarder.link_scenario(scenario)
        begin(rewarder, scenario, satellites)

        def play(*found, seconds=60.0):
            simulator.sim_time += seconds
            scenario.inspection.next = {(1, k): flags for k, flags in enumerate(found)}
            return step(rewarder, satellites)

        return rewarder, play

    return satellites, scenario, start


def test_new_points_are_paid_to_each_who_inspects_them(crew):
    satellites, scenario, start = crew
    rewarder, play = start(inspection_reward_scale=2.0, min_illuminated_for_completion=2.0)
    assert scenario.inspection.places == ((0, 0), [(1, 0), (1, 1)])
    assert play(([0, 1], [0, 1, 2]), ([1], [1])) == {"RSO": 0.0, "I0": 0.4, "I1": 0.2}
    assert play(([1, 2], []), ([1], [])) == {"RSO": 0.0, "I0": 0.2, "I1": 0.0}
    assert (rewarder.data.num_points_inspected, rewarder.data.num_points_illuminated) == (3, 3)
    assert satellites[1].data_store.data.num_points_inspected == 3
    assert satellites[2].data_store.data.num_points_inspected == 1
    assert satellites[0].data_store.role == "rso"


def test_completion_is_paid_once_to_all_and_ends_the_episode(crew):
    satellites, scenario, start = crew
    rewarder, play = start(completion_bonus=5.0, completion_threshold=0.5, min_illuminated_for_completion=0.4)
    assert play(([0], [0, 1, 2]), ([], [])) == {"RSO": 0.0, "I0": 0.1, "I1": 0.0}  # three of ten are lit
    assert not rewarder.is_terminated(satellites[1])
    assert play(([], [3]), ([1], [])) == {"RSO": 5.0, "I0": 5.0, "I1": 5.1}
    assert rewarder.is_terminated(satellites[0])
    assert rewarder.bonus_reward_time == 120.0
    assert play(([4], []), ([], []))["I0"] == 0.1
    old = scenario.inspection
    begin(rewarder, scenario, satellites)
    assert not rewarder.bonus_reward_yielded
    assert rewarder.bonus_reward_time is None
    assert old.next is None, "the observer of the last episode continues"


def test_completion_comes_by_time_too_and_may_leave_the_episode_going(crew):
    satellites, _, start = crew
    rewarder, play = start(completion_bonus=1.0, min_time_for_completion=100.0, terminate_on_completion=False)
    assert play(([0], [0]), ([], [])) == {"RSO": 0.0, "I0": 0.1, "I1": 0.0}
    assert play(([], []), ([], []))["RSO"] == 1.0
    assert not rewarder.is_terminated(satellites[0])


def test_knowledge_of_points_is_that_of_either():
    one, other = RSOInspectionData({"a": False, "b": True}, {"a": True}), RSOInspectionData({"a": True, "c": False})
    both = one + other
    assert both.point_inspect_status == {"a": True, "b": True, "c": False}
    assert both.point_illuminate_status == {"a": True}
    assert repr(both) == "RSOInspectionData(inspected=2, illuminated=1)"


def test_rejects_wrong_satellites(crew):
    satellites, scenario, start = crew

    def blind():
        satellites[1].__class__ = type("Blind", (Inspector,), {"fsw": None})
        start()

    def twice():
        satellites[1].__class__ = Inspector
        satellites.append(Target("Second", core_row=(0, 1)))
        scenario.reset_overwrite_previous()
        scenario.reset_pre_sim_init()

    table = [
        refusal(blind, AssertionError, "I0", "RSOInspectorFSWModel"),
        refusal(twice, AssertionError, ["RSO", "Second"], "RSODynModel"),
    ]
    check_refusals(table)
