"""Every hook of a subclass runs and leaves nothing of the package behind."""

from types import SimpleNamespace

import torch
from tensordict import TensorDict

from bsk_torch import SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.sim.state import StateTable
from tests.support.refusals import check_refusals, refusal

from .conftest import HoldingFleet, key, rows_of


def rows(n: int = 2) -> torch.Tensor:
    return torch.arange(n)


def attached(scenario, n: int = 2):
    """The scenario at the start of n episodes, as an environment calls it."""
    fleet = HoldingFleet(n)
    fleet.memory = StateTable(n)
    scenario.attach(fleet)
    fleet.keep(rows(n), scenario.draw_checked(key(n)))
    scenario.begin_episodes(rows(n))
    return scenario


def finish(scenario, time: float) -> None:
    scenario.fleet.sim_time = torch.full_like(scenario.fleet.sim_time, time)
    scenario.finish_step(scenario.fleet.sim_time)


class Deadlines(scene.ChangingTargets, scene.UniformTargets):
    """Targets that vanish after a minute."""

    def at(self, time):
        late = (time >= 60.0).unsqueeze(-1)
        return torch.where(late, 5.0, self.drawn("target_priority")), ~late.expand(-1, self.most_targets)


def test_targets_change_whatever_after_step_does():
    class Counted(Deadlines):
        steps = 0

        def after_step(self, sim_time):
            self.steps += 1

    scenario = attached(Counted(3, 2.0))
    assert scenario.available.all()
    finish(scenario, 60.0)
    assert scenario.steps == 1
    assert not scenario.available.any()
    assert (scenario.priority == 5.0).all()


def test_targets_are_those_of_the_new_episode_whatever_reset_does():
    class Counted(scene.UniformTargets):
        resets = 0

        def reset(self, rows):
            self.resets += 1

    scenario = attached(Counted((1, 9)), 20)
    before = scenario.available
    fleet, again = scenario.fleet, torch.arange(10, 20)
    fleet.keep(again, scenario.draw_checked(rows_of(key(20, episode=1), again.tolist())))
    scenario.begin_episodes(again)
    assert scenario.resets == 2
    assert torch.equal(scenario.available, fleet.scenario_state["target_exists"].bool())
    assert not torch.equal(scenario.available, before)


def test_priorities_are_those_of_the_new_episode_whatever_reset_does():
    class Idle(Deadlines):
        def reset(self, rows):
            pass

    scenario = attached(Idle(3, 2.0))
    finish(scenario, 60.0)
    scenario.fleet.sim_time = torch.tensor([60.0, 0.0], dtype=torch.float64)
    scenario.begin_episodes(torch.tensor([1]))
    assert scenario.available.tolist() == [[False] * 3, [True] * 3]


def test_at_is_evaluated_once_a_step():
    class Counted(Deadlines):
        calls = 0

        def at(self, time):
            self.calls += 1
            return super().at(time)

    scenario = attached(Counted(3, 2.0))
    assert scenario.calls == 1
    finish(scenario, 30.0)
    assert scenario.priority is scenario.priority
    assert scenario.calls == 2


def test_targets_that_change_under_clouds_that_change():
    """Both scenarios move on: that in front, and the one that the clouds are over."""

    class Thinning(scene.ChangingTargets, scene.CloudyTargets):
        def at(self, time):
            return self.drawn("target_priority"), torch.ones_like(self.drawn("target_exists"), dtype=torch.bool)

    scenario = attached(Thinning(Deadlines(3, 2.0)))
    assert scenario.available.all()
    finish(scenario, 60.0)
    assert not scenario.available.any()


def test_link_without_super():
    """It does no harm to a scenario that the package's link does not prepare, and is an error for others."""

    class Plain(scene.Scenario):
        def link(self, fleet):
            self.linked = True

    plain = Plain()
    plain.attach(SimpleNamespace())
    assert plain.linked

    class Lost(scene.UniformTargets):
        def link(self, fleet):
            pass

    check_refusals(refusal(lambda: Lost(3).attach(HoldingFleet(2)), TypeError, "Lost.link(fleet)", "super()", "link(fleet)"))


def test_rejects_draws_of_other_names_and_shapes():
    class Fickle(scene.UniformTargets):
        extra = ("mood",)

        def draw(self, key):
            return super().draw(key) | {name: torch.zeros(1, len(name)).double() for name in self.extra}

    scenario = attached(Fickle(3))

    def draw(*extra):
        scenario.extra = extra
        return scenario.draw_checked(key(2))

    check_refusals(
        refusal(draw, ValueError, "Fickle.draw(key)", "target_exists [3]", "mood [4]"),
        refusal(lambda: draw("moods"), ValueError, "Fickle.draw(key)", "moods [5]", "mood [4]"),
    )


class Own(scene.UniformTargets):
    """Counts steps in an attribute."""

    def link(self, fleet):
        super().link(fleet)
        self.count = torch.zeros(fleet.num_envs)

    def after_step(self, sim_time):
        self.count = self.count + 1.0


class InPlace(Own):
    def after_step(self, sim_time):
        self.count += 1.0


def test_rejects_tensors_of_its_own():
    flown = [attached(cls(3), n) for cls in (Own, InPlace) for n in (1, 2)]
    for scenario in flown:
        finish(scenario, 1.0)
    check_refusals(
        refusal(lambda s=s: finish(s, 2.0), TypeError, f"{type(s).__name__}.count", "fleet.memory.declare", "'_count'")
        for s in flown
    )


def test_tensors_that_may_be_kept():
    """Constants, tables that are built when they are first needed, caches with an underscore, and memory."""

    class Fine(scene.UniformTargets):
        def link(self, fleet):
            super().link(fleet)
            self.constant = torch.ones(fleet.num_envs)
            fleet.memory.declare("steps", 0)

        def after_step(self, sim_time):
            if sim_time[0] >= 2.0 and not hasattr(self, "late"):
                self.late = torch.ones(2)
            self._cache = 2.0 * sim_time
            self.fleet.memory["steps"] = self.fleet.memory["steps"] + 1

    scenario = attached(Fine(3))
    for time in (1.0, 2.0, 3.0):
        finish(scenario, time)
    assert scenario.fleet.memory["steps"].tolist() == [3, 3]


class Recorded(scene.UniformTargets):
    """Notes the calls of its hooks."""

    calls: list[str]

    def draw(self, key):
        self.calls.append("draw")
        return super().draw(key)

    def link(self, fleet):
        self.calls.append("link")

        super().link(fleet)

    def reset(self, rows):
        self.calls.append(f"reset {rows.tolist()}")

    def after_step(self, sim_time):
        self.calls.append(f"after_step {sim_time.tolist()}")


def test_hooks_run_in_an_environment():
    attributes = {"action_spec": (act.Charge(duration=5.0),), "observation_spec": (obs.Time(norm=1.0),)}
    satellite = type("Imager", (sats.ImagingSatellite,), attributes)("A")
    scenario = Recorded(400)
    scenario.calls = []
    env = SatelliteTasking(satellite, scenario, data.NoReward(), num_envs=2, time_limit=60.0, seed=1, backend="eager")
    assert scenario.calls.count("link") == 2  # once for a trial episode
    scenario.calls.clear()
    env.reset()
    assert scenario.calls == ["draw", "reset [0, 1]"]
    scenario.calls.clear()
    env.step(TensorDict({"action": torch.tensor([0, 0])}, env.batch_size))
    assert scenario.calls == ["after_step [5.0, 5.0]"]


class Arrivals(scene.UniformTargets):
    """Targets that arrive at times that nobody knows in advance."""

    def draw(self, key):
        return super().draw(key) | {"arrival": 100.0 * key.named("arrival").uniform(self.most_targets)}

    def redraw(self, rows, key, time):
        arrival, now = self.drawn("arrival")[rows], time.unsqueeze(-1)
        to_come = now + (100.0 - now) * key.named("arrival").uniform(self.most_targets)
        return {"arrival": torch.where(arrival > now, to_come, arrival)}


def test_hidden_draws_are_drawn_again_in_their_rows_only():
    class Counted(Arrivals):
        begun = 0

        def reset(self, rows):
            self.begun += 1

    scenario = attached(Counted(40), 3)
    before, again = scenario.drawn("arrival").clone(), torch.tensor([2, 0])
    time = torch.tensor([60.0, 20.0], dtype=torch.float64)
    scenario.draw_again(again, key(2, seed=11), time)
    after = scenario.drawn("arrival")
    assert torch.equal(after[1], before[1])
    for row, now in ((2, 60.0), (0, 20.0)):
        come = before[row] <= now
        assert torch.equal(after[row][come], before[row][come])
        assert bool((after[row][~come] > now).all())
        assert not bool((after[row][~come] == before[row][~come]).any())
    assert scenario.begun == 2
    attached(scene.UniformTargets(3)).draw_again(rows(), key(2), torch.zeros(2))  # without a hook, nothing changes


def test_rejects_what_cannot_be_drawn_again():
    def again(values):
        class Wrong(scene.UniformTargets):
            def redraw(self, rows, key, time):
                return values

        attached(Wrong(3)).draw_again(rows(), key(2), torch.zeros(2))

    check_refusals(
        refusal(lambda: again({"target_priorit": torch.ones(2, 3)}), ValueError, "'target_priorit'", "'target_priority'"),
        refusal(lambda: again({"target_r_LP_P": torch.ones(2, 3, 3)}), ValueError, "'target_r_LP_P'"),
        refusal(lambda: again({"target_priority": torch.ones(2, 4)}), ValueError, "'target_priority'", "[2, 4]", "[2, 3]"),
        refusal(lambda: again({"target_priority": torch.full((2, 3), torch.nan)}), ValueError, "'target_priority'", "finite"),
    )
