"""Rewards of a user's own for images, from public names only: beliefs, uncertain places, strips."""

import pytest
import torch
from tensordict import TensorDict

import bsk_torch
from bsk_torch import data, scene

pytestmark = pytest.mark.compiled

N, T = 2, 40


def imaging(rewarder, scenario, **options):
    fixed = dict(num_envs=N, seed=4, time_limit=3000.0, dtype=torch.float64)
    return bsk_torch.make("AEOS-v1", scenario=scenario, rewarder=rewarder, **(fixed | options))


def fly(env):
    """One step, in which time passes; return its duration, [N]."""
    return env.step(TensorDict({"action": torch.zeros(N, dtype=torch.int64)}, [N]))["next", "duration"].squeeze(-1)


def image(env, target):
    """Let both satellites take an image of a target now; return what that pays, [N]."""
    return env.rewarder.value(torch.full((N, 1), target), torch.ones(N, 1, dtype=torch.bool)).squeeze(1)


class BeliefReward(data.ImageReward):
    """Each picture raises the belief that one of them shows the ground; targets remain until it is above 0.95."""

    share_of_pictures, tau = 0.5, 360.0

    def link(self, scenario, fleet):
        super().link(scenario, fleet)
        for name, initial in (("belief", 0.0), ("last_picture", -1e9)):
            self.memory.declare(name, initial, scenario.most_targets)

    def selectable(self):
        return (self.scenario.available & (self.memory["belief"] <= 0.95)).unsqueeze(1)

    def value(self, target, taken):
        now = self.fleet.sim_time.unsqueeze(1)
        belief, last = (self.scenario.look_up(self.memory[name], target) for name in ("belief", "last_picture"))
        worth, cloud = (self.scenario.look_up(name, target) for name in ("priority", "cloud_forecast"))
        fresh = 1.0 - torch.exp(-(now - last) / self.tau)
        new = torch.where(taken, belief + (1.0 - belief) * (1.0 - cloud) * fresh, belief)
        self.memory["belief"] = self.memory["belief"].scatter(1, target, new)
        self.memory["last_picture"] = self.memory["last_picture"].scatter(1, target, torch.where(taken, now, last))
        sure = (new > 0.95) & (belief <= 0.95)
        return worth * (self.share_of_pictures * (new - belief) + (1.0 - self.share_of_pictures) * sure)


def test_beliefs_of_repeated_images():
    env = imaging(BeliefReward(), scene.CloudyTargets(scene.UniformTargets(T), cover=0.4, forecast_sigma=0.0))
    env.reset()
    worth = env.scenario.priority[:, 7]
    assert torch.allclose(image(env, 7), 0.5 * 0.6 * worth)
    assert torch.allclose(image(env, 7), torch.zeros(N).double())  # no time has passed since the first picture
    assert env.satellite.allowed("target")[:, 7].all()
    expected, last = torch.full((N,), 0.6).double(), torch.zeros(N).double()
    for _ in range(30):
        last += fly(env)
        before, expected = expected, expected + (1.0 - expected) * 0.6 * (1.0 - torch.exp(-last / 360.0))
        paid, last = image(env, 7), torch.zeros_like(last)
        bonus = 0.5 * ((expected > 0.95) & (before <= 0.95))
        assert torch.allclose(paid, worth * (0.5 * (expected - before) + bonus))
        if (expected > 0.95).all():
            break
    assert torch.equal(env.satellite.allowed("target")[:, 7], expected <= 0.95)
    assert (expected > 0.95).any()
    env.reset(TensorDict({"_reset": torch.tensor([[True], [False]])}, [N]))
    assert env.rewarder.memory["belief"][:, 7].tolist() == [0.0, pytest.approx(expected[1].item())]


class Uncertain(scene.UniformTargets):
    """Targets are believed to be at ``r_LP_P``; where they are is known to the rewarder only."""

    def draw(self, key):
        values = super().draw(key)
        error = 2000.0 * key.named("target_error").normal(3 * self.most_targets).view(len(key), -1, 3)
        return values | {"target_true_r_LP_P": values["target_r_LP_P"] + error}


class FootprintReward(data.UniqueImageReward):
    def value(self, target, taken):
        believed, true = (self.scenario.look_up(name, target) for name in ("r_LP_P", "true_r_LP_P"))
        inside = (believed - true).norm(dim=-1) <= 3000.0
        return super().value(target, taken & inside)


def test_images_of_uncertain_places():
    env = imaging(FootprintReward(), Uncertain(T))
    env.reset()
    error = (env.scenario.target_attribute("true_r_LP_P") - env.scenario.r_LP_P).norm(dim=-1)
    inside = error <= 3000.0
    for target in range(10):
        paid = image(env, target)
        assert torch.equal(paid > 0.0, inside[:, target])
        assert torch.equal(env.satellite.allowed("target")[:, target], ~inside[:, target])  # try again
    assert 0 < inside[:, :10].sum() < 10 * N


class StripReward(data.UniqueImageReward):
    """Pays for a target that has been in view, chosen, for as long as its strip takes."""

    def link(self, scenario, fleet):
        super().link(scenario, fleet)
        self.memory.declare("dwell", 0.0, scenario.most_targets)

    def value(self, target, taken):
        dwell = self.memory["dwell"].scatter_add(1, target, self.step_duration.unsqueeze(1))
        self.memory["dwell"] = dwell
        done = self.scenario.look_up(dwell, target) >= self.scenario.look_up("strip_duration", target)
        return super().value(target, taken & done)


class Strips(scene.UniformTargets):
    def draw(self, key):
        return super().draw(key) | {"target_strip_duration": 600.0 * key.named("strips").uniform(self.most_targets)}


def test_strips_that_take_time():
    """Only the step in which the strip is complete pays."""
    env = imaging(StripReward(), Strips(T))
    env.reset()
    wanted, seen, paid = env.scenario.target_attribute("strip_duration")[:, 3], [], []
    spent = torch.zeros(N).double()
    for _ in range(12):
        env.rewarder.memory["dwell"][:, 3] = spent  # whatever was chosen in the step, it is put down to target 3
        fly(env)
        env.rewarder.memory["dwell"][:, 3] = spent
        paid.append(image(env, 3) > 0.0)
        spent = spent + env.rewarder.step_duration
        seen.append(spent >= wanted)
    complete = torch.stack(seen)
    first = complete & (complete.cumsum(0) == 1)
    assert torch.equal(torch.stack(paid), first)
    assert first.any()
