"""Actions of real numbers: their hooks, specs, what is refused, and what NO_ACTION and values outside the bounds mean."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs.utils import check_env_specs

from bsk_torch import NO_ACTION, ConstellationTasking, SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.env.action_forms import OpenBox, box
from bsk_torch.sim import dyn, fsw
from tests.act.thrust_image import ThrustImageBox, ThrustImageHybrid
from tests.env.test_state import N, strays
from tests.support.episodes import begun, unchanged
from tests.support.refusals import check_refusals, refusal

START = dict(oe=None, rN=[6.9e6, 0.0, 0.0], vN=[0.0, 6080.0, 4560.0])


class Point(act.ContinuousAction):
    """Point along the Hill frame for as long as the only number says."""

    def __init__(self, name="point"):
        super().__init__(name)
        self.calls = []

    def bounds(self):
        return [2.0], [50.0]

    def names(self):
        return ["seconds"]

    def decide(self, action, mask):
        return self.enter("nadir_point", action[:, 0].clamp(2.0, 50.0), action)

    def begin(self, mask, decision):
        self.calls.append(("begin", mask.tolist(), decision.command[:, 0].tolist()))

    def end(self, mask, decision, event):
        self.calls.append(("end", mask.tolist(), decision.command[:, 0].tolist()))


class Choose(act.HybridAction):
    """Drift or point along the Hill frame for some seconds."""

    def bounds(self):
        return torch.tensor([1.0]), torch.tensor([50.0])

    def names(self):
        return ["seconds"]

    def choices(self):
        return ["drift", "point"]

    def mask(self):
        legal = torch.ones(len(self.satellite.simulator.ticks), 2, dtype=torch.bool)
        legal[:, 1] = self.satellite.simulator.ticks < 20
        return legal

    def decide(self, action, mask):
        drift, point = (self.enter(command, action[:, 0].clamp(1.0, 50.0)) for command in ("drift", "nadir_point"))
        return drift._replace(mode=torch.where(action[:, 1] > 0, point.mode, drift.mode))


def kind(*entries, models=(dyn.DynamicsModel, fsw.FSWModel), name="Real", base=sats.Satellite):
    spec = (obs.SatProperties(dict(prop="sigma_BN"), dict(prop="r_BN_N")), obs.Time(norm=1.0))
    attributes = {"action_spec": entries, "observation_spec": spec, "dyn_type": models[0], "fsw_type": models[1]}
    return type(name, (base,), attributes)


def alone(entry, num_envs=2, base=sats.Satellite, models=(dyn.DynamicsModel, fsw.FSWModel), **options):
    options = dict(time_limit=100.0, seed=1, dtype=torch.float64) | options
    return SatelliteTasking(kind(entry, base=base, models=models)("A", START), num_envs=num_envs, **options)


def step(env, action, mask=None):
    td = TensorDict({"action": action}, env.batch_size)
    return env.step(td if mask is None else td.set("_step", mask))["next"]


def seconds(env, *numbers, mask=None, dtype=torch.float64):
    return step(env, torch.tensor(numbers, dtype=dtype).unsqueeze(-1), mask)["duration"].flatten().tolist()


class TestHooks:
    def test_decide_begin_and_end_run_with_the_action(self):
        env = begun(alone(Point()))
        assert seconds(env, 7.0, 60.0) == [7.0, 50.0]
        assert env.satellite.actions.entries[0].calls == [
            ("begin", [True, True], [7.0, 60.0]),
            ("end", [True, True], [7.0, 60.0]),
        ]
        assert env.satellite.action_description == ["seconds"]

    def test_rejects_results_that_do_not_fit(self):
        made = lambda **members: alone(type("Mine", (Point,), members)(), backend="eager")
        bounds = lambda *result: made(bounds=lambda self: result if len(result) > 1 else result[0])
        check_refusals(
            refusal(lambda: bounds([0.0, 0.0], [1.0]), ValueError, "bounds()", [2], [1]),
            refusal(lambda: bounds([1.0], [1.0]), ValueError, "bounds()", [1.0]),
            refusal(lambda: bounds([math.nan], [1.0]), ValueError, "bounds()", [math.nan], [1.0]),
            refusal(lambda: bounds(3.0), ValueError, "bounds()", 3.0),
            refusal(lambda: bounds(["a"], ["b"]), ValueError, "bounds()", ["a"], ["b"], "numbers"),
            refusal(lambda: made(names=lambda self: ["a", "b"]), ValueError, "names()", ["a", "b"], 1),
            refusal(lambda: made(names=lambda self: "s"), ValueError, "names()", "'s'", 1),
            refusal(lambda: made(link_satellite=lambda self, satellite: None), TypeError, "super().link_satellite"),
        )

    def test_rejects_wrong_decisions(self):
        changes = []
        decide = lambda self, action, mask: changes[-1](Point.decide(self, action, mask))
        env = begun(alone(type("Mine", (Point,), dict(decide=decide))(), backend="eager"))
        decided = lambda change: (changes.append(change), seconds(env, 3.0, 4.0))
        check_refusals(
            refusal(lambda: decided(lambda d: d._replace(duration=d.duration * 0.0)), ValueError, "duration", 0.0, 1e-9),
            refusal(lambda: decided(lambda d: d._replace(duration=d.duration * math.nan)), ValueError, "duration", "nan", 1e-9),
            refusal(lambda: decided(lambda d: d._replace(duration=d.duration.float())), TypeError, "duration", "torch.float32"),
            refusal(lambda: decided(lambda d: None), TypeError, "Mine.decide", None, "act.Decision"),
        )

    def test_rejects_entries_beside_a_continuous_one(self):
        lists = (Point(), act.Drift()), (act.Drift(), Point()), (Point(), Point("other"))
        tasking = lambda entries: SatelliteTasking(kind(*entries)("A"))
        check_refusals(refusal(lambda x=x: tasking(x), ValueError, "Real.action_spec", "'point'") for x in lists)

    def test_an_action_is_carried_out_anew(self):
        """An equal action twice resets what its mode resets: there is no rule for repeated actions."""
        env = begun(alone(act.AttitudeSetpoint(control_period=5.0), models=(dyn.BasicDynamicsModel, fsw.BasicFSWModel)))
        same = torch.tensor([[0.1, 0.2, 0.3]] * 2, dtype=torch.float64)
        step(env, same)
        decided = env.satellite.actions.decide(same, env.satellite.task.previous_action, torch.tensor([True, True]))
        assert decided.retask.all()


def test_definitions_that_would_not_be_used():
    wrong = [
        (dict(set_action=lambda self, action: None), "Mine.set_action", "decide", "bsk_torch.bsk_rl"),
        (dict(space=property(lambda self: None)), "Mine.space", "bounds"),
        (dict(bounds=property(lambda self: None)), "Mine.bounds", "property", "method"),
        (dict(decide=lambda self, action: None), "Mine.decide", "decide(action, mask)"),
        (dict(decides=lambda self, action, mask: None), "Mine.decides", "'decide'"),
    ]
    bases = (act.ContinuousAction,), (act.AttitudeSetpoint,), (act.HybridAction,)
    check_refusals(
        refusal(lambda base=base, members=members: type("Mine", base, members), TypeError, *names)
        for base in bases
        for members, *names in wrong
    )


class TestSpecs:
    @pytest.mark.parametrize(
        ("low", "high", "expected"),
        [
            ([-1.0, 0.0], [1.0, 2.0], Bounded),
            ([-torch.inf] * 2, [torch.inf] * 2, Unbounded),
            ([-torch.inf, 2.0], [torch.inf] * 2, OpenBox),
        ],
    )
    def test_kinds(self, low, high, expected):
        spec = box(torch.tensor(low), torch.tensor(high), (4,), torch.float32)
        values = spec.rand((1000,))
        assert isinstance(spec, expected)
        assert values.shape == (1000, 4, 2)
        assert torch.isfinite(values).all()
        assert spec.is_in(values)

    def test_an_open_box_stays_one(self):
        low, high = torch.tensor([-torch.inf, 2.0, 0.0, -torch.inf]), torch.tensor([torch.inf, torch.inf, 1.0, 5.0])
        spec = box(low, high, (4,), torch.float32)
        others = [
            spec[0],
            spec[:2],
            spec.clone(),
            spec.expand(3, 4, 4),
            spec.to(torch.float64),
            spec.unsqueeze(0),
            spec.to("cpu"),
        ]
        for other in others:
            assert type(other) is OpenBox
            assert torch.isfinite(other.rand()).all()
        assert spec.to(torch.float64).rand().dtype == torch.float64
        draws = spec.rand((20000,)).reshape(-1, 4)
        assert draws.mean(0).tolist() == pytest.approx(
            [0.0, 3.0, 0.5, 4.0], abs=0.02
        )  # as Gymnasium's Box: mean 1 beyond a bound
        assert draws.std(0).tolist() == pytest.approx([1.0, 1.0, 12**-0.5, 1.0], abs=0.02)

    def test_environments_of_every_kind(self):
        mover = dict(models=(dyn.DynamicsModel, fsw.MagicOrbitalManeuverFSWModel))
        for env in (
            alone(Point()),
            alone(Choose("choose")),
            alone(act.AttitudeSetpoint(control_period=5.0)),
            alone(act.ImpulsiveThrust(), **mover),
            alone(act.ImpulsiveThrust(max_dv=1.0, max_drift_duration=20.0), dtype=torch.float32, **mover),
        ):
            check_env_specs(env, seed=0)
            td = env.rollout(3)
            assert ("action_mask" in set(td.keys())) == env.satellite.actions.is_hybrid


class TestGivenActions:
    def test_rejects_wrong_values_before_anything_moves(self):
        env = begun(alone(Point()))
        wrong = [
            (torch.tensor([[1], [2]]), TypeError, "dtype torch.int64", "floating-point"),
            (torch.tensor([[True], [False]]), TypeError, "dtype torch.bool"),
            (torch.tensor([1.0, 2.0]), ValueError, [2], [2, 1], "seconds"),
            (torch.tensor([[1.0, 2.0]] * 2), ValueError, [2, 2], [2, 1], "seconds"),
            (torch.tensor([[1.0], [torch.nan]]), ValueError, "environment 1", "seconds=nan", "finite"),
            (torch.tensor([[torch.inf], [1.0]]), ValueError, "environment 0", "seconds=inf"),
        ]
        with unchanged(env):
            check_refusals(refusal(lambda action=action: step(env, action), *names) for action, *names in wrong)

    def test_numbers_of_rows_that_do_not_step_do_not_matter(self):
        env = begun(alone(Point()))
        assert seconds(env, 3.0, torch.nan, mask=torch.tensor([[True], [False]]))[0] == 3.0
        assert env.fleet.ticks.tolist() == [3, 0]

    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    def test_no_action_goes_on_with_the_task(self, dtype):
        env = begun(alone(Point(), max_step_duration=4.0))
        assert seconds(env, 10.0, 3.0, dtype=dtype) == [4.0, 3.0]
        assert seconds(env, NO_ACTION, 5.0, dtype=dtype) == [4.0, 4.0]
        assert seconds(env, NO_ACTION, NO_ACTION, dtype=dtype) == [2.0, 1.0]
        assert [call[1] for call in env.satellite.actions.entries[0].calls if call[0] == "begin"] == [
            [True, True],
            [False, True],
            [False, False],
        ]

    def test_a_hybrid_action_in_its_two_parts_or_side_by_side(self):
        env = alone(Choose("choose"))
        assert isinstance(env.full_action_spec["action"], Composite)
        td = env.reset()
        assert td["action_mask"].tolist() == [[True, True]] * 2
        choice = torch.tensor([1, 0])
        parts = {"values": torch.tensor([[21.0], [3.0]]), "choice": choice}
        td = step(env, TensorDict(parts, [2]))
        assert td["duration"].flatten().tolist() == [21.0, 3.0]
        assert td["action_mask"].tolist() == [[True, False], [True, True]]
        assert [env.simulator.mode_names[k] for k in env.simulator.mode.tolist()] == ["nadir_point", "drift"]
        env.play(torch.tensor([[5.0, 0.0], [3.0, 1.0]]))
        assert [env.simulator.mode_names[k] for k in env.simulator.mode.tolist()] == ["drift", "nadir_point"]

    def test_rejects_wrong_hybrid_actions(self):
        env = begun(alone(Choose("choose"), backend="eager"))
        values, choice = torch.ones(2, 1), torch.zeros(2).long()
        wrong = [
            (dict(values=values), TypeError, "'values'", "'choice'"),
            (dict(values=torch.ones(2, 2), choice=choice), ValueError, "action['values']", [2, 2], [2, 1]),
            (dict(values=values, choice=torch.zeros(2)), TypeError, "action['choice']", "integer"),
            (dict(values=values.long(), choice=choice), TypeError, "action['values']", "floating-point"),
            (dict(values=values, choice=torch.tensor([0, 2])), ValueError, "choice 2", "environment 1"),
            (dict(values=values * math.nan, choice=choice), ValueError, "seconds=nan"),
        ]
        half = refusal(lambda: env.play(torch.tensor([[5.0, 0.5], [3.0, 1.0]])), ValueError, "choice 0.5")
        given = [refusal(lambda x=x: step(env, TensorDict(x, [2])), error, *names) for x, error, *names in wrong]
        check_refusals(row for other in given for row in (other, half))

    def test_records_name_the_numbers(self, caplog):
        env = begun(alone(Choose("choose"), log_level="DEBUG", num_envs=1))
        with caplog.at_level("DEBUG", logger="bsk_torch"):
            env.play(torch.tensor([[5.5, 1.0]]))
        chosen = next(record for record in caplog.records if record.event == "chose")
        assert chosen.getMessage() == "point, seconds 5.5, until 6.0 s at the latest"
        assert chosen.action == [5.5, 1.0]
        assert next(record for record in caplog.records if record.event == "legal").getMessage() == "may drift, point"


class TestState:
    def test_an_action_in_progress_is_saved_and_restored(self):
        env = begun(alone(Choose("choose"), max_step_duration=4.0))
        env.play(torch.tensor([[13.0, 1.0], [9.0, 0.0]]))
        saved = env.get_state()
        go_on = torch.full((2, 2), float(NO_ACTION), dtype=torch.float64)
        first = [env.play(go_on)["observation"] for _ in range(3)]
        other = alone(Choose("choose"), max_step_duration=4.0)
        other.restore(saved)
        assert other.satellites[0].task.action.tolist() == [[13.0, 1.0], [9.0, 0.0]]
        again = [other.play(go_on)["observation"] for _ in range(3)]
        assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
        saved["satellites_0", "task", "action"][0, 0] = torch.nan
        check_refusals(refusal(lambda: other.restore(saved), ValueError, "task.action"))

    @pytest.mark.parametrize("entry", [Choose("choose"), act.ImpulsiveThrust(max_dv=1.0)], ids=["hybrid", "thrust"])
    def test_tensors_of_the_batch_are_declared_or_derived(self, entry):
        models = (dyn.DynamicsModel, fsw.MagicOrbitalManeuverFSWModel)
        env = alone(entry, num_envs=N, models=models, time_limit=30.0, max_step_duration=5.0)
        env.rollout(8)
        assert not strays(env)

    def test_episodes_do_not_depend_on_the_batch(self):
        actions = torch.rand(3, 4, 3, dtype=torch.float64) * 2.0 - 1.0
        models = dyn.BasicDynamicsModel, fsw.BasicFSWModel
        many = alone(act.AttitudeSetpoint(control_period=5.0), num_envs=4, models=models)
        single = alone(act.AttitudeSetpoint(control_period=5.0), num_envs=1, env_ids=[2], models=models)
        assert torch.equal(many.reset()["observation"][2:3], single.reset()["observation"])
        for action in actions:
            assert torch.equal(step(many, action)["observation"][2:3], step(single, action[2:3])["observation"])

    def test_partial_steps_touch_only_their_rows(self):
        env = begun(alone(Point(), num_envs=3))
        seconds(env, 5.0, 6.0, 7.0)
        before = env.get_state()
        seconds(env, 9.0, 9.0, 9.0, mask=torch.tensor([[False], [True], [False]]))
        after = env.get_state()
        for key in before.keys(True, True):
            assert torch.equal(before[key][[0, 2]], after[key][[0, 2]]), key


class TestConstellations:
    def make(self, **options):
        turner = kind(act.AttitudeSetpoint(control_period=6.0), models=(dyn.BasicDynamicsModel, fsw.BasicFSWModel), name="Turner")
        discrete = kind(act.Drift(duration=7.0), act.NadirPoint(duration=3.0), name="Discrete")
        satellites = [turner("T1"), discrete("D1"), kind(Choose("choose"), name="Hybrid")("H1"), turner("T2")]
        options = dict(num_envs=2, time_limit=60.0, seed=1, dtype=torch.float64) | options
        return ConstellationTasking(satellites, **options)

    def test_types_side_by_side(self):
        env = self.make()
        check_env_specs(env, seed=0)
        assert env.group_map == {"turner": ["T1", "T2"], "discrete": ["D1"], "hybrid": ["H1"]}
        td = env.reset()
        assert "action_mask" not in set(td["turner"].keys())
        assert td["hybrid", "action_mask"].shape == (2, 1, 3)
        td["turner", "action"] = torch.full((2, 2, 3), 0.1)
        td["turner", "action"][0, 1] = NO_ACTION
        td["discrete", "action"] = torch.tensor([[1], [2]])
        td["hybrid", "action"] = TensorDict(
            values=torch.tensor([[[5.0]]] * 2), choice=torch.tensor([[2], [0]]), batch_size=[2, 1]
        )
        td = env.step(td)["next"]
        assert td["duration"].flatten().tolist() == [3.0, 5.0]
        names = {name: env.satellites[k].task.requires_retasking.tolist() for k, name in enumerate(env.group_map)}
        assert names == {"turner": [False, True, False, False], "discrete": [True, True], "hybrid": [True, True]}
        assert td["hybrid", "action_mask"].tolist() == [[[True, True, False]]] * 2

    def test_one_agent_of_all_satellites(self):
        env = self.make(joint=True)
        check_env_specs(env, seed=0)
        td = env.reset()
        assert set(env.full_action_spec["action"].keys()) == {"T1", "D1", "H1", "T2"}
        assert td["action_mask"].shape == (2, 6)  # two and three numbers, each with one that goes on
        check_refusals(refusal(lambda: env.step(td.set("action", torch.zeros(2, 4).long())), TypeError, "satellite"))

    def test_rejects_meta_agents(self):
        crew = {"both": ["T1", "D1"]}
        check_refusals(refusal(lambda: self.make(meta_agent_groupings=crew, backend="eager"), ValueError, "'both'", "T1"))

    def test_only_satellites_of_numbers_of_real_actions_under_one_agent(self):
        point = kind(Point())
        env = ConstellationTasking(
            [point("A"), point("B")], joint=True, backend="eager", time_limit=30.0, dtype=torch.float64, seed=1
        )
        check_env_specs(env, seed=0)
        td = env.reset()
        assert "action_mask" not in set(td.keys())
        act_ = {"A": torch.tensor([[4.0]]), "B": torch.tensor([[float(NO_ACTION)]])}
        assert float(env.step(td.set("action", TensorDict(act_, [1])))["next", "duration"]) == 4.0


class TestHybridsOfImages:
    """An own class of five numbers, and one of four numbers and a choice, do the same."""

    def make(self, entry):
        imager = kind(
            entry,
            base=sats.ImagingSatellite,
            models=((dyn.ImagingDynModel, dyn.GroundStationDynModel), (fsw.MagicOrbitalManeuverFSWModel, fsw.ImagingFSWModel)),
        )
        sat_args = START | dict(imageAttErrorRequirement=0.1, imageRateErrorRequirement=0.1, dv_available_init=500.0)
        options = dict(num_envs=2, seed=1, dtype=torch.float64, time_limit=500.0)
        return SatelliteTasking(imager("A", sat_args), scene.UniformTargets(3000), data.UniqueImageReward(), **options)

    def test_both_forms(self):
        boxed, hybrid = self.make(ThrustImageBox(max_dv=5.0, max_drift_duration=60.0)), self.make(ThrustImageHybrid(max_dv=5.0))
        assert boxed.action_spec.high[0].tolist() == [5.0, 5.0, 5.0, 60.0, 3.0]
        assert hybrid.satellite.actions.choices == ["drift", *(f"action_image_{k}" for k in range(4))]
        boxed.reset(), hybrid.reset()
        values = torch.tensor([[1.0, 2.0, 3.0, 40.0], [0.0, 0.0, 0.0, 60.0]], dtype=torch.float64)
        for choice in (torch.tensor([0, 1]), torch.tensor([2, 0]), torch.tensor([1, 4])):
            one = step(boxed, torch.cat([values, choice.double().unsqueeze(-1) - 1.0], 1))
            two = step(hybrid, TensorDict(values=values, choice=choice, batch_size=[2]))
            for key in ("observation", "reward", "duration"):
                assert torch.equal(one[key], two[key])
        assert int(boxed.counts()["imaged"].sum()) > 0
