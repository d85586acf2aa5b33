"""
.. _tutorial-yours:

Your constellation in 20 lines
==============================

Fly satellites of a TLE file over cities of a CSV file, let a trained policy plan their images, and open the flight in the viewer.

The two sample files of this page hold 20 real satellites that observe the Earth, with element sets of April 2026, and the hundred
most populous cities. Replace their paths by the paths of your files.
"""

# %%
# Result
# ------
#
# ``from_tle`` makes one satellite of each element set, on the orbit that SGP4 gives at the epoch of the episode. ``from_csv``
# puts the cities on the ellipsoid of WGS84. Spacecraft, observation and actions are as in ``AEOS-v1``, and the policy was trained
# for ``AEOSConstellation-v1``; it decides for each satellite among the next 32 places in view.
import torch

from bsk_torch import ConstellationTasking, comm, data, scene
from bsk_torch.formats import SAMPLES
from bsk_torch.presets.aeos import AgileSatellite, agile_args, looking_ahead
from bsk_torch.recording import record
from bsk_torch.rl.marl import shared
from bsk_torch.rl.policies import pretrained

# sphinx_gallery_thumbnail_number = 1
HOURS = 6.0

torch.set_num_threads(1)

spacecraft = {name: value for name, value in agile_args().items() if name != "oe"}
satellites = AgileSatellite.from_tle(
    SAMPLES / "earth_observation.tle",
    spacecraft,
    may_see_nothing=True,
    **looking_ahead(as_set=True),
)
env = ConstellationTasking(
    satellites,
    scene.Targets.from_csv(SAMPLES / "cities.csv"),
    data.UniqueImageReward(),
    comm.FreeCommunication(min_period=60.0),
    world_args={"utc_init": "2026-04-14T00:00:00Z"},
    num_envs=1,
    time_limit=3600.0 * HOURS,
    sim_rate=0.5,
    seed=0,
)
policy = shared(pretrained("AEOSConstellation-v1"), env)

# %%
# Flight, viewer, schedule
# ------------------------
#
# ``record`` plays an episode. The page opens in any browser; the schedule has a row for each task, image, pass and eclipse, and
# STK, GMAT and Orekit read the orbits.
from pathlib import Path

from bsk_torch.viewer.oem import oem
from bsk_torch.viewer.schedule import schedule

flight = record(env, policy, until=3600.0 * HOURS, label="pretrained")
Path("constellation.html").write_text(flight.html(), encoding="utf-8")
Path("schedule.csv").write_text(schedule(flight, "csv"), encoding="utf-8")
Path("constellation.oem").write_text(oem(flight), encoding="utf-8")

lines = schedule(flight, "csv").splitlines()
print(lines[0], *[line for line in lines if "rewarded" in line][:5], sep="\n")

# %%
# The satellites at the end of the flight:
from matplotlib import pyplot as plt

plt.imshow(env.render(rows=0).numpy())
plt.axis("off")

# %%
# Next steps
# ----------
#
# Access windows alone need no environment:
#
# .. code-block:: bash
#
#     bsk-torch windows --tle my.tle --targets cities.csv --start 2026-04-14 --hours 6 --out windows.csv
#
# - :doc:`/how_to/real_orbits` lists formats and the accuracy of orbits and windows.
# - :doc:`/how_to/requests` gives places times, durations and weights, which may change in flight.
# - :doc:`/how_to/areas` records regions instead of points.
