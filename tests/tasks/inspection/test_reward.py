"""The reward for inspecting an RSO: who is paid, when the inspection is complete, and what satellites know."""

from __future__ import annotations

import torch

from bsk_torch import comm, rand
from bsk_torch.tasks.inspection import SphericalRSO
from bsk_torch.wrappers import PettingZooEnv
from tests.tasks.inspection.inspecting import POINTS, RSO, Inspector, act_all, chief_args, inspection, inspector_args


def reward_of(outputs, env, k: int) -> torch.Tensor:
    return outputs[env.groups[k].name]["reward"][..., 0]


def test_two_inspectors_of_one_point_are_both_paid_once():
    """Above and behind share some points; the reward counts points not inspected before the step."""
    env = inspection(scenario=SphericalRSO(**POINTS | dict(theta_solar_max=-1.0, min_illumination_factor=0.0)))
    td = act_all(env, env.reset())
    reward = env.rewarder.rewarders[0]
    known, n = reward.known.inspected, reward.inspected.shape[1]
    assert not known[:, 0].any()
    shared = (known[:, 1] & known[:, 2]).sum(1)
    assert (shared > 0).all()
    assert torch.equal(reward.inspected, known.any(1))
    torch.testing.assert_close(reward_of(td, env, 1), known[:, 1:].sum(2).double() / n, rtol=0, atol=1e-15)
    assert (reward_of(td, env, 0) == 0.0).all()
    before = reward.inspected.clone()
    td = act_all(env, td)
    gained = (reward.known.inspected & ~before.unsqueeze(1)).sum(2)[:, 1:]
    torch.testing.assert_close(reward_of(td, env, 1), gained.double() / n, rtol=0, atol=1e-15)


def test_who_does_not_record_inspects_nothing():
    env = inspection()
    td = act_all(env, env.reset(), inspectors=1)
    assert not env.rewarder.inspected.any()
    assert env.rewarder.illuminated.any()
    assert (reward_of(td, env, 1) == 0.0).all()


def test_completion_pays_every_satellite_once_and_ends_the_episode():
    reward = dict(completion_bonus=2.0, completion_threshold=0.1, min_time_for_completion=30.0)
    env = inspection(reward=reward)
    td = act_all(env, env.reset())
    assert not env.rewarder.bonus_reward_yielded.any()
    assert env.rewarder.bonus_reward_time.isnan().all()
    td = act_all(env, td)
    assert (env.rewarder.bonus_reward_time == 40.0).all()
    assert (reward_of(td, env, 0) == 2.0).all()
    assert (reward_of(td, env, 1) >= 2.0).all()
    assert td["terminated"].all()


def test_an_episode_goes_on_after_completion_where_asked_or_as_in_bsk_rl():
    reward = dict(completion_bonus=2.0, completion_threshold=0.0, min_illuminated_for_completion=0.01)
    for options in (dict(reward=reward | dict(terminate_on_completion=False)), dict(reward=reward, compat="bsk_rl")):
        env = inspection(**options)
        td = act_all(env, env.reset())
        assert env.rewarder.bonus_reward_yielded.all()
        assert not td["done"].any()
        td = act_all(env, td)
        assert (reward_of(td, env, 0) == 0.0).all()  # the bonus does not come again
        assert bool(env.rewarder.is_terminated().all()) is ("compat" in options)


def test_agents_stay_in_pettingzoo_as_in_bsk_rl():
    reward = dict(completion_threshold=0.0, min_illuminated_for_completion=0.01)
    for compat, stay in ((None, []), ("bsk_rl", ["RSO", "Above", "Behind"])):
        env = PettingZooEnv(inspection(reward=reward, num_envs=1, compat=compat))
        env.reset(seed=1)
        ended = env.step(dict.fromkeys(env.agents, 0))[2]
        assert ended == dict.fromkeys(env.possible_agents, True)
        assert env.agents == stay


def test_nothing_is_paid_for_a_dark_rso_but_in_bsk_rl():
    """No point is lit where the Sun must stand exactly over it: 0 inspected points of 0 are enough there, after a time."""
    dark = SphericalRSO(**POINTS | dict(theta_solar_max=0.0))
    reward = dict(completion_bonus=1.0, min_time_for_completion=5.0)
    for compat, paid in ((None, False), ("bsk_rl", True)):
        env = inspection(scenario=dark, reward=reward, compat=compat)
        act_all(env, env.reset())
        assert not env.rewarder.illuminated.any()
        assert env.rewarder.bonus_reward_yielded.tolist() == [paid] * 2


def test_points_under_the_false_attitude_do_not_count_but_in_bsk_rl():
    """There the attitude is zero for two records, in which other points are seen than along the Hill frame.

    A first step of three ticks of 5 s is one whose length rounding makes bsk_rl miss, so they count as lit, too.
    """

    class Short(Inspector):
        action_spec = (Inspector.action_spec[0].__class__("inspect_rso", duration=15.0),)

    satellites = [RSO("RSO", chief_args()), Short("A", inspector_args(100.0, 0.0, 0.0))]
    found = {}
    for compat in (None, "bsk_rl"):
        env = inspection(satellites, compat=compat, num_envs=1)
        act_all(env, env.reset())
        found[compat] = env.rewarder.inspected[0], env.rewarder.illuminated[0]
    (seen, lit), (false_seen, false_lit) = found[None], found["bsk_rl"]
    assert seen.any()
    assert (false_seen & ~seen).any()
    assert (false_lit & ~lit).any()
    # true: the inspector is above, along the x axis of the Hill frame and so of the body
    normals = torch.tensor([point.n_B.tolist() for point in env.scenario.rso_points])
    assert (normals[seen, 0] > 0.3).all()
    assert (normals[false_seen, 0] < 0.3).any()


def test_knowledge_spreads_by_communication():
    env = inspection(communicator=comm.FreeCommunication())
    act_all(env, env.reset())
    known = env.rewarder.known
    for table, everything in ((known.inspected, env.rewarder.inspected), (known.illuminated, env.rewarder.illuminated)):
        assert table.any()
        assert torch.equal(table, everything.unsqueeze(1).expand_as(table))
    above, behind = env.satellites[1].data_store.data.inspected.view(2, 2, -1).unbind(1)
    assert torch.equal(above, behind)


def test_partial_steps_and_resets_leave_other_episodes_alone():
    env, whole = inspection(num_envs=3), inspection(num_envs=3)
    td, other = act_all(env, env.reset()), act_all(whole, whole.reset())
    td["_step"] = torch.tensor([True, False, True])
    before = env.rewarder.inspected.clone()
    act_all(env, td)
    act_all(whole, other)
    assert torch.equal(env.rewarder.inspected[1], before[1])
    assert torch.equal(env.rewarder.inspected[[0, 2]], whole.rewarder.inspected[[0, 2]])
    mask = torch.tensor([[False], [False], [True]])
    td = env.fake_tensordict()
    td["_reset"] = mask
    env.reset(td)
    assert not env.rewarder.inspected[2].any()
    assert torch.equal(env.rewarder.inspected[1], before[1])


def test_fuel_is_charged_with_weights_of_each_episode():
    """The RSO has no tank; its change is zero. Weights are drawn, and observed."""
    env = inspection(weight=rand.Uniform(0.0, 0.5))
    td = env.reset()
    weight = env.rewarder.rewarders[1].reward_weight
    assert len(set(weight.tolist())) == 2
    assert torch.equal(td[env.groups[1].name]["observation"][..., -1], weight.unsqueeze(1).expand(-1, 2))
    simulator = env.fleet.simulators[1]
    before = env.rewarder.read_log()
    simulator.thrust(torch.tensor([True, False, True, False]), torch.tensor([[0.0, 2.0, 0.0]], dtype=torch.float64).expand(4, -1))
    paid = env.rewarder.rewarders[1].calculate_reward({"resource": before["1.resource"]}, env.rewarder.rewarders[1].read_log())
    torch.testing.assert_close(paid, -2.0 * weight.unsqueeze(1) * torch.tensor([0.0, 1.0, 0.0]), rtol=1e-14, atol=0)
    first = weight.clone()
    env.reset()
    assert (env.rewarder.rewarders[1].reward_weight != first).all()
