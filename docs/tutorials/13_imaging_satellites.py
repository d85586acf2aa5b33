"""
.. _tutorial-satellites:

Image other satellites
======================

Take images of the objects of a catalog from orbit, downlink them, and look at the sky of the imager.

An object is imaged from a distance of thousands of kilometers: the imager points at it, and takes the image once the requirements
on pointing, light and line of sight have been met for ten seconds. An image counts when it has reached the ground.
"""

# %%
# Result
# ------
#
# One imager flies at an altitude of 600 km, and 60 objects at 700 to 1400 km. A rule downlinks in view of a ground station, and
# otherwise images the most important object that is in sight and in sunlight.
import torch
from tensordict.nn import TensorDictModule

from bsk_torch import ConstellationTasking, act, dyn, obs, rand, sats
from bsk_torch.tasks.objects import (
    ImageRSO,
    RandomRSOCatalog,
    RSOImageReward,
    RSOTargetProperties,
    RSOTargets,
    SpaceToSpaceImagingDynModel,
    SpaceToSpaceImagingFSWModel,
)

# sphinx_gallery_thumbnail_number = 2
OBJECTS = 60
SECONDS = 11_400.0
EPISODES = 256

torch.set_num_threads(1)


class Imager(sats.AccessSatellite):
    dyn_type = (SpaceToSpaceImagingDynModel, dyn.GroundStationDynModel)
    fsw_type = SpaceToSpaceImagingFSWModel
    observation_spec = [
        obs.SatProperties(dict(prop="storage_level_fraction")),
        RSOTargetProperties(n_ahead_observe=10),
        obs.OpportunityProperties(
            dict(prop="opportunity_open", norm=5700.0),
            dict(prop="opportunity_close", norm=5700.0),
            type="ground_station",
            n_ahead_observe=1,
        ),
        obs.Time(),
    ]
    action_spec = [
        act.Charge(duration=60.0),
        act.Downlink(duration=60.0),
        ImageRSO(10, max_duration=120.0, min_pointing_hold_s=10.0),
    ]


def make(num_envs, **options):
    radii = [7070.0 + 700.0 * k / OBJECTS for k in range(OBJECTS)]  # km
    catalog = RandomRSOCatalog(
        OBJECTS, oe=[rand.random_orbit(a=radius, i=60.0) for radius in radii]
    )
    imager = Imager(
        "Scout",
        dict(
            oe=rand.random_orbit(a=6971.0, i=50.0),
            imageAttErrorRequirement=0.01,
            instrumentBaudRate=8e6,  # bits of an image
            dataStorageCapacity=20 * 8e6,
            transmitterBaudRate=-4e6,
            u_max=0.4,
        ),
    )
    return ConstellationTasking(
        [imager],
        scenario=RSOTargets(catalog, ["Scout"]),
        rewarder=RSOImageReward(cooldown_s=3600.0),
        time_limit=SECONDS,
        num_envs=num_envs,
        **options,
    )


CHARGE, DOWNLINK, IMAGE = range(3)


def choose(env, rank):
    """Return actions, [N, 1]; ``rank`` of candidates in sight and in light, [N, 10], decides."""
    scout = env.satellites[0]
    candidates = env.scenario.candidates(scout, 10)
    seen = env.scenario.views(scout, candidates)
    lit = seen.target_illumination_factor >= 0.5
    possible = env.scenario.in_sight(scout, candidates) & lit
    best = torch.where(possible, rank(env, candidates, seen), -torch.inf).argmax(1)
    action = torch.where(possible.any(1), IMAGE + best, CHARGE)
    level = scout.dynamics.storage_level_fraction
    action = torch.where(level >= 1.0, CHARGE, action)
    contact = scout.find_next_opportunities(1, "ground_station").open[:, 0]
    in_view = contact <= scout.simulator.sim_time
    return torch.where(in_view & (level > 0.0), DOWNLINK, action).unsqueeze(1)


def important(env, candidates, seen):
    return env.scenario.priority.gather(1, candidates.place)


def player(env, rank):
    return TensorDictModule(
        lambda mask: choose(env, rank),
        in_keys=[("agents", "action_mask")],
        out_keys=[("agents", "action")],
    )


from bsk_torch.viz.episodes import draw, record

env = make(1)
episode = record(player(env, important), env, seed=4)
path = draw(episode, "services.png", "the most important first")
print(episode.outcome)

# %%
# Each row is an object. A bar begins with an image of the object and ends with the last bit of its downlink; until then, the
# object cannot be chosen. After that, it cannot be chosen until the cooldown ends, an hour after the image. Most of the delay is
# the wait for a station: the eight megabits of an image need two seconds of contact.
#
# See what the imager sees
# ------------------------
#
# After a quarter of an hour, some objects have been imaged. The map shows directions: the direction of flight is in the middle,
# the opposite direction at both edges, and the zenith at the top. The Earth hides objects below its limb, except those in front
# of it. The numbers denote the candidates, in the order in which they are observed and chosen: from 21 degrees below the
# horizontal upwards, whether they are hidden or not.
from pathlib import Path

from bsk_torch.tasks.objects.figure import sky_figure
from bsk_torch.viz.recorders.rso_imaging import sky_of

env.set_seed(4)
td = env.reset()
while float(env.fleet.sim_time[0]) < min(900.0, 0.5 * SECONDS):
    td = env.step(player(env, important)(td))["next"]
path = sky_figure(sky_of(env), Path("sky.png"))
scout = env.satellites[0]
print(env.scenario.candidate_ids(scout, 0, 5))
print(td["agents", "action_mask"][0, 0].int().tolist())

# %%
# An image requires light, line of sight and pointing at the same time. An action that images an object ends with the image, or
# after two minutes without one. The action mask only excludes places without a candidate.
#
# Compare rules
# -------------
#
# Rules are functions of all episodes at once. The following rules differ only in the function that ranks the candidates.
from bsk_torch.rl.evaluation import evaluate


def nearby(env, candidates, seen):
    return -seen.target_distance


def ahead(env, candidates, seen):
    return -seen.angle_to_target


env = make(EPISODES)
for rank in (important, nearby, ahead):
    result = evaluate(player(env, rank), env, seed=1)
    images, delivered = (count.double().mean() for count in env.counts().values())
    print(
        f"{rank.__name__:10} return {result.mean_return},",
        f"{images:.1f} images, {delivered:.1f} delivered",
    )

# %%
# A rule that turns less takes more images, but of less important objects.
#
# Next steps
# ----------
#
# - The how-to guide "Image objects in orbit": conditions of an image, several imagers, catalogs of bsk_rl.
# - :ref:`sphx_glr_gallery_bsk_rl_space_to_space_rso_imaging.py`: bsk_rl's example.
# - :ref:`tutorial-inspection`: look at a spacecraft from close range.
# - :ref:`tutorial-film`: films and figures of episodes.
