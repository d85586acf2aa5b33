"""Packets with records of images: who may send, what is sent, and when it arrives."""

from __future__ import annotations

import random

import pytest
import torch

from bsk_torch import act
from bsk_torch.sim import dyn
from bsk_torch.sim.component import Bus
from bsk_torch.tasks.objects import (
    CatalogCommunication,
    CatalogRadioDynModel,
    CatalogRadioFSWModel,
    RSOTargets,
    RSOTeamReward,
    TransmitCatalog,
)
from bsk_torch.tasks.objects.radio import transmit_packet
from bsk_torch.tasks.objects.scene import sorted_peers
from bsk_torch.vec3 import Vec3
from tests.tasks.objects.objects import Imager, catalog, environment, play, state

CHARGE, DOWNLINK, FIRST, SEND, STAY = 0, 1, 2, 5, -1


class Sender(Imager):
    dyn_type = (CatalogRadioDynModel, dyn.GroundStationDynModel)
    fsw_type = CatalogRadioFSWModel
    action_spec = (*Imager.action_spec, TransmitCatalog(1))


class Everywhere(Sender):
    action_spec = (*Imager.action_spec, TransmitCatalog(1, link_mode="ideal"))


def team(imagers=2, kind=Sender, knowledge="own", **options):
    names = [f"Imager{k}" for k in range(imagers)]
    defaults = dict(
        scenario=RSOTargets(catalog(), names, knowledge=knowledge),
        rewarder=RSOTeamReward(quality_threshold=0.0, cooldown_s=900.0),
        communicator=CatalogCommunication(),
    )
    return environment(imagers=imagers, kind=kind, **(defaults | options))


def legal(env, imager, action, row=0):
    """Whether an imager may choose an action in an environment."""
    count = env.satellites[0].simulator.count
    return bool(env.satellites[0].action_mask().view(env.num_envs, count, -1)[row, imager, action])


def step(env, *actions):
    """Step; STAY continues."""
    n = env.satellites[0].actions.n_actions
    return play(env, *(n if action == STAY else action for action in actions))


def capture(env, imager=0):
    """Let an imager take an image, while the other one charges."""
    before = env.rewarder.counts()["captured"][0, imager].item()
    while env.rewarder.counts()["captured"][0, imager] == before:
        step(env, *(FIRST if k == imager else CHARGE for k in range(2)))


def send(env):
    """Let imager 0 transmit until a packet is on its way; return the time of this."""
    before = env.scenario.records.sent[0, 0].item()
    step(env, SEND, CHARGE)
    while env.scenario.records.sent[0, 0] == before:
        step(env, STAY, CHARGE)
    return env.fleet.sim_time[0].item()


def test_nobody_is_its_own_peer():
    assert sorted_peers(["b", "c", "a"])[0].tolist() == [[2, 1], [2, 0], [0, 1]]
    assert sorted_peers(["only"]).shape == (1, 1, 0)


def link_bus(valid, held, hold, points, here, there):
    bus = Bus(10**9)
    row = lambda value: torch.tensor([float(value)], dtype=torch.float64)
    bus.radio_armed, bus.radio_valid, bus.radio_held, bus.radio_hold = row(1), row(valid), row(held), row(hold)
    bus.radio_sees_all, bus.rso_pointed, bus.images = row(0), row(points), row(0)
    bus.r_BN_N, bus.r_TN_N = (Vec3(*(row(x) for x in r)) for r in (here, there))
    return bus


def test_a_break_restarts_the_hold():
    """Against a loop over ticks with random pointing and lines of sight."""
    here, near, behind = (7e6, 0.0, 0.0), (5e6, 6e6, 0.0), (-7e6, 1.0, 0.0)
    numbers = random.Random(1)
    for _ in range(20):
        bus, held, before = link_bus(0, 0, 4, 1, here, near), 0.0, False
        for _ in range(60):
            points, sees = numbers.random() < 0.9, numbers.random() < 0.95
            bus.rso_pointed = torch.tensor([float(points)], dtype=torch.float64)
            bus.r_TN_N = link_bus(0, 0, 4, 1, here, near if sees else behind).r_TN_N
            bus.stop = torch.tensor([False])
            transmit_packet(bus)
            valid = points and sees
            held = held + 1.0 if valid and before else 0.0
            before = valid
            assert bool(bus.stop) == (held >= 4.0)
            if held >= 4.0:
                assert bus.radio_armed.item() == bus.radio_valid.item() == 0.0
                break
            assert bus.radio_held.item() == held
            assert bool(bus.radio_valid) == valid


def test_the_line_must_clear_a_sphere():
    radius = 6378136.6
    for height, clear in ((-1.0, False), (0.5, True)):
        bus = link_bus(1, 0, 1, 1, (radius + height, -1e7, 0.0), (radius + height, 1e7, 0.0))
        transmit_packet(bus)
        assert (bool(bus.radio_valid) or bool(bus.stop)) == clear


@pytest.mark.compiled
def test_only_news_can_be_told_and_a_packet_tells_both():
    env = team()
    env.reset()
    assert not legal(env, 0, SEND)
    capture(env)
    assert legal(env, 0, SEND)
    assert not legal(env, 1, SEND)
    began = env.fleet.sim_time[0].item()
    arrived = send(env)
    assert arrived >= began + 10.0
    assert env.links[0].tolist() == [[False, True], [False, False]]
    records = env.scenario.records
    assert records.known[0, 0].tolist() == [1, 1]
    assert records.received[0, 0, :, 0].tolist() == [began, arrived]
    assert records.exchanged[0, 0, 1].item() == arrived
    assert not legal(env, 0, SEND)
    assert not legal(env, 1, SEND)  # it knows that imager 0 knows
    while env.rewarder.counts()["delivered"][0, 0] == 0:
        step(env, DOWNLINK, CHARGE)
    assert legal(env, 0, SEND)  # the delivery is news
    send(env)
    assert records.known[0, 0].tolist() == [2, 2]


@pytest.mark.compiled
def test_the_radio_draws_power_while_its_link_is_valid():
    """Ten ticks of the hold, 25 W each, in the ticks that follow."""
    charges = []
    for power in (0.0, -25.0):
        env = team(sat_args=dict(radioPowerDraw=power, storedCharge_Init=5e8))
        env.reset()
        capture(env)
        send(env)
        charges.append(env.satellites[0].dynamics.battery_charge[0].item())
    assert charges[0] - charges[1] == pytest.approx(250.0, abs=1e-5)  # of 5e8 J


@pytest.mark.compiled
def test_imagers_are_followed_with_the_orbits_of_targets():
    """Where the radio points: both orbits are solved in advance in the same field, from the same initial state."""
    env = team()
    env.reset()
    for _ in range(12):
        step(env, CHARGE, CHARGE)
    followed = env.scenario.orbits.positions(env.fleet.sim_time)[..., env.scenario.n_targets :].movedim(0, -1)
    flown = env.fleet.each(lambda satellite: satellite.dynamics.r_BN_N)
    assert float((followed - flown).abs().max()) < 1e-5


@pytest.mark.compiled
def test_a_packet_holds_what_was_known_at_its_beginning():
    env = team()
    env.reset()
    capture(env)
    records = env.scenario.records
    step(env, SEND, FIRST)
    assert (records.packet[0, :, 0] > 0).sum() == 1
    if records.sent[0, 0] == 0:
        records.packet[0, 0, 0] = 0  # what is not in it does not arrive
        while records.sent[0, 0] == 0:
            step(env, STAY, CHARGE)
        assert records.known[0, 0].tolist() == [1, 0]


@pytest.mark.compiled
def test_another_command_drops_the_packet():
    env = team()
    env.reset()
    capture(env)
    step(env, SEND, FIRST)
    records = env.scenario.records
    if records.sent[0, 0] == 0:
        for _ in range(3):
            step(env, CHARGE, CHARGE)
        assert records.sent[0, 0] == 0
        assert legal(env, 0, SEND)


@pytest.mark.compiled
@pytest.mark.parametrize(("kind", "may"), [(Sender, False), (Everywhere, True)])
def test_the_earth_blocks_links(kind, may):
    r_N, v_N = state(3.0)
    there = lambda satellites: {satellites[1]: {"rN": r_N.tolist(), "vN": v_N.tolist()}}
    env = team(kind=kind, sat_arg_randomizer=there)
    env.reset()
    capture(env)
    assert legal(env, 0, SEND) == may
    assert env.scenario.linked[0, 0].tolist() == [True, False]


@pytest.mark.compiled
def test_packets_come_late_or_not_at_all():
    for options, arrives in (
        (dict(delay_s=100.0), True),
        (dict(loss_probability=1.0), False),
        (dict(delay_s=40.0, ttl_s=40.0), False),
    ):
        env = team(communicator=CatalogCommunication(**options))
        env.reset()
        capture(env)
        sent = send(env)
        delay = options.get("delay_s", 0.0)
        while env.fleet.sim_time[0] < sent + delay:
            assert env.scenario.records.known[0, 0].tolist() == [1, 0]
            step(env, CHARGE, CHARGE)
        assert env.scenario.records.known[0, 0].tolist() == [1, int(arrives)]
        assert legal(env, 0, SEND) != arrives


@pytest.mark.compiled
def test_losses_do_not_depend_on_the_batch():
    few, many = (team(communicator=CatalogCommunication(loss_probability=0.5), num_envs=n) for n in (2, 6))
    for env in (few, many):
        env.reset()
        capture(env)
        for _ in range(4):
            if env.scenario.records.known[:2, 0, 1].eq(0).any():
                step(env, SEND, CHARGE)
    steps = min(int(few.scenario.records.sent.sum()), 1)
    assert steps == 1
    assert torch.equal(few.scenario.records.known, many.scenario.records.known[:2])


@pytest.mark.compiled
def test_a_repeated_choice_continues_the_task_if_asked_to():
    """Imager 1 ends steps; imager 0 chooses its object, or its packet, again."""
    runs = {}
    for name, repeats, options in (
        ("stay", False, {}),
        ("repeat", True, dict(continue_repeated=True)),
        ("restart", True, {}),
    ):
        env = team(mask_busy=False, **options)
        env.reset()
        seen = []
        for k in range(4):
            target = env.scenario.candidate_ids(env.satellites[0], 0, 1)
            step(env, act.image_target(2) if repeats or k == 0 else STAY, CHARGE)
            task = env.satellites[0].task
            seen.append((target, env.fleet.sim_time[0].item(), task.ends[0].item(), bool(task.requires_retasking[0])))
            if task.requires_retasking[0]:
                break
        runs[name] = seen
    assert runs["repeat"] == runs["stay"]
    assert runs["restart"] != runs["stay"] or len(runs["stay"]) == 1
