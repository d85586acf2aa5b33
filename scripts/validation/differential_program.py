"""Programs for the differential tester of ``bsk_torch.bsk_rl``: drawn problems that leave draws and forms to the library.

There, a seed must give bsk_rl's episode without any mapping. So arguments are left out or drawn by functions of NumPy's
generator, orbits, epochs and targets are random, satellites share names, observations are dictionaries, and episodes follow one
another.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from differential_draw import RELATIVE, Case, Craft, Draw, Drawn, Part, entries

LEFT_OUT = (
    ("sigma_init", "omega_init"),
    ("wheelSpeeds",),
    ("disturbance_vector",),
    ("storedCharge_Init", "batteryStorageCapacity"),
    ("storageInit",),
)
"""Arguments that are left to their defaults together; most of these are random."""

VARIED = (
    *("mass", "panelArea", "dragCoeff", "basePowerDraw", "instrumentPowerDraw", "transmitterPowerDraw"),
    *("u_max", "hs_min", "K", "P", "K1", "servo_Ki", "storedCharge_Init"),
)
"""Arguments that functions draw between 0.8 times and their given value."""


def as_program(case: Case) -> Case:
    """Return a problem whose draws are left, in part, to the library."""
    draw = Draw(case.seed + 1_000_000)
    rigid = case.family in ("inspect", "close")  # which must start near one another
    randomizer = None
    if not rigid and len(case.crafts) > 1 and draw.chance(0.25):
        options = dict(altitude=draw.uniform(450.0, 1400.0), inc=draw.uniform(20.0, 100.0), rel_phasing=draw.uniform(0.0, 40.0))
        randomizer = Part("walker_delta_args", (), dict(n_planes=draw.one(1, len(case.crafts))) | options)
    if not rigid and len(case.crafts) > 1 and "meta_agent_groupings" not in case.env and draw.chance(0.2):
        case = replace(case, crafts=tuple(replace(one, name=f"Twin_{k}", called="Twin") for k, one in enumerate(case.crafts)))
    crafts = tuple(_freed(draw, one, case, rigid, randomizer is not None) for one in case.crafts)
    world, env = dict(case.world_args), dict(case.env)
    if draw.chance(0.4):
        world.pop("utc_init")
    if draw.chance(0.3) and env["time_limit"] != float("inf"):
        env["time_limit"] = Drawn(0.8 * env["time_limit"], env["time_limit"])
    if draw.chance(0.1):
        env["dtype"] = "float32"
    episodes = draw.one(1, 2, 2, 3)
    return replace(
        case,
        crafts=crafts,
        world_args=world,
        env=env,
        scenario=_scenario(draw, case),
        rewarders=tuple(_rewarder(draw, part) for part in case.rewarders),
        communicator=_communicator(draw, case),
        randomizer=randomizer,
        seeds=tuple(draw.whole(0, 10**6) for _ in range(episodes)),
        program=True,
    )


def _freed(draw: Draw, one: Craft, case: Case, rigid: bool, placed: bool) -> Craft:
    """Return a satellite that leaves some of its arguments to the library."""
    args = dict(one.sat_args)
    for names in LEFT_OUT:
        if draw.chance(0.35) and not (rigid and "batteryStorageCapacity" in names):
            for name in names:
                args.pop(name, None)
    for name in VARIED:
        if name in args and args[name] is not None and draw.chance(0.3):
            args[name] = Drawn(*sorted((0.8 * args[name], args[name])))
    orbit: Any = one.orbit
    if placed:
        orbit = None
    elif not rigid and draw.chance(0.6):
        kind = draw.one("random_orbit", "random_circular_orbit", "default")
        inclination = draw.one({}, dict(i=draw.uniform(0.0, 180.0)))
        orbit = {
            "random_orbit": Part(
                kind, (), dict(a=draw.uniform(6900.0, 7900.0), e=draw.one(0.0, draw.uniform(0.0, 0.03))) | inclination
            ),
            "random_circular_orbit": Part(kind, (), dict(alt=draw.uniform(350.0, 1500.0)) | inclination),
            "default": None,
        }[kind]
    options = dict(one.options)
    if case.view != "agents" and draw.chance(0.2):
        options["obs_type"] = draw.one("dict", "list")
    return replace(
        one,
        sat_args=args,
        orbit=orbit,
        options=options,
        observations=_observations(draw, one, case),
        actions=_actions(draw, one, case),
    )


def _observations(draw: Draw, one: Craft, case: Case) -> tuple[Part, ...]:
    """Return the observations, with further ones."""
    parts = list(one.observations)
    if draw.chance(0.3):
        parts.append(
            Part(
                "SatProperties",
                tuple(dict(prop=name, fn=name) for name in draw.some(("height", "age", "sun"), 1)),
                dict(name="own"),
            )
        )
    if draw.chance(0.2):
        parts.append(Part("Time", (), dict(observe_time_remaining=True, norm=100.0)))  # a second one of this name
    if draw.chance(0.3) and any(part.name == "ResourceReward" for part in case.rewarders):
        parts.append(Part("ResourceRewardWeight"))
    if len(case.crafts) > 1 and case.family not in ("inspect", "close") and one.name != case.crafts[0].name and draw.chance(0.2):
        parts.append(Part("RelativeProperties", entries(draw, RELATIVE[:4]), dict(chief_name=case.crafts[0].name)))
    if one.base == "ImagingSatellite" and draw.chance(0.2):
        parts.append(
            Part(
                "OpportunityProperties",
                (dict(prop="priority"), dict(name="length", fn="length", norm=300.0)),
                dict(n_ahead_observe=2),
            )
        )
    return tuple(parts)


def _actions(draw: Draw, one: Craft, case: Case) -> tuple[Part, ...]:
    """Return the actions, with a broadcast where several satellites have discrete ones."""
    if one.choices and len(case.crafts) > 1 and draw.chance(0.3):
        return (*one.actions, Part("Broadcast", (), dict(duration=draw.duration(case.env["sim_rate"]))))
    return one.actions


def _scenario(draw: Draw, case: Case) -> Part:
    """Return the scenario; targets are drawn by the library, mostly."""
    if case.scenario.name != "Targets" or draw.chance(0.2):
        return case.scenario
    low = draw.whole(100, 800)
    options: dict[str, Any] = {}
    if draw.chance(0.4):
        options["priority_distribution"] = Drawn(0.5, 2.0)
    if draw.chance(0.2):
        options["radius"] = 6.3e6
    if draw.chance(0.3):
        options |= dict(n_select_from=draw.one(None, 2000, 10000), location_offset=draw.one(0.0, 1e4, 1e5))
        return Part("CityTargets", (low,), options)
    return Part("UniformTargets", (draw.one(low, (low, 2 * low)),), options)


def _rewarder(draw: Draw, part: Part) -> Part:
    """Return a rewarder, with a function of the user's or a random weight."""
    if part.name == "UniqueImageReward" and draw.chance(0.4):
        return Part(part.name, (), dict(reward_fn="squared"))
    if part.name == "ResourceReward" and draw.chance(0.5):
        weight = part.options["reward_weight"]
        return Part(part.name, (), part.options | dict(reward_weight=Drawn(*sorted((weight, 2.0 * weight)))))
    return part


def _communicator(draw: Draw, case: Case) -> Part | None:
    """Return the communication, now and then only of what is broadcast."""
    if (
        case.communicator is None
        or case.communicator.name not in ("FreeCommunication", "LOSCommunication")
        or not draw.chance(0.4)
    ):
        return case.communicator
    return case.communicator._replace(name=f"Broadcast{case.communicator.name}")
