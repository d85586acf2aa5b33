"""Durations and modes that users' actions return are checked."""

import math

import pytest
import torch
from tensordict import TensorDict

from bsk_torch import SatelliteTasking, act, obs, sats
from tests.support.refusals import check_refusals, refusal


def environment(orbit: str | None = None, **hooks) -> SatelliteTasking:
    class Satellite(sats.Satellite):
        observation_spec = (obs.Time(),)
        action_spec = (act.Drift(duration=10.0), type("Mine", (act.Action,), hooks)("mine"))

    env = SatelliteTasking(Satellite("A"), num_envs=2, time_limit=60.0, seed=0, backend="eager", orbit=orbit)
    env.reset()
    return env


def play(env: SatelliteTasking) -> torch.Tensor:
    return env.step(TensorDict({"action": torch.ones(2, dtype=torch.int64)}, [2]))["next", "duration"].flatten()


def deciding(seconds: float, mode: int = 1):
    def decide(self, index, mask, action, previous):
        duration = torch.full((2,), seconds, dtype=torch.float64)
        return act.Decision(torch.full_like(action, mode), action != previous, duration, action, duration)

    return decide


@pytest.mark.parametrize("seconds", [math.inf, 1e300])
def test_endless_durations_last_until_the_episode_ends(seconds):
    assert play(environment(decide=deciding(seconds))).tolist() == [60.0, 60.0]


def test_rejects_wrong_decisions():
    decisions = []
    env = environment(decide=lambda self, *args: decisions[-1](self, *args))
    decided = lambda *decision: (decisions.append(deciding(*decision)), play(env))
    durations = math.nan, -1.0, 0.0, 1e-12
    check_refusals(
        *(refusal(lambda x=x: decided(x), ValueError, "Mine.decide", "duration", x, "environment 0", 1e-9) for x in durations),
        *(refusal(lambda mode=mode: decided(5.0, mode), ValueError, "Mine.decide", "mode", mode, 0) for mode in (-1, 99)),
        refusal(lambda: act.Charge(duration=1e-12), ValueError, "duration=1e-12"),
        refusal(lambda: SatelliteTasking(sats.Satellite("A"), max_step_duration=1e-12), ValueError, "max_step_duration=1e-12"),
    )


def test_rejects_wrong_modes_of_tables():
    columns = torch.zeros(1, dtype=torch.bool), torch.ones(1, dtype=torch.float64)
    modes = []
    env = environment(table=lambda self: act.ActionTable(torch.full((2, 1), modes[-1]), *columns))
    tabled = lambda mode: (modes.append(mode), play(env))
    check_refusals(refusal(lambda m=m: tabled(m), ValueError, "Mine.table()", "mode", m, 0) for m in (-1, 99))


def test_rejects_writes_of_wrong_shapes():
    env, rows = environment("integrated", decide=deciding(5.0)), torch.ones(2, dtype=torch.bool)
    write = lambda value: env.simulator.write("r_BN_N", rows, value)
    wrong = (1.0, 1.0), (torch.ones(17), [17]), (torch.ones(1), [1])
    check_refusals(refusal(lambda x=x: write(x), ValueError, "write('r_BN_N'", shown, [2, 3]) for x, shown in wrong)
