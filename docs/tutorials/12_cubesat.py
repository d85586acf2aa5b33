"""
.. _tutorial-cubesat:

Fly a CubeSat for a day
=======================

Fly a 6U CubeSat of the spacecraft library for a day. At noon, one of its four wheels breaks; the flight software is told so an
hour later.
"""

# %%
# Result
# ------
#
# The satellite points at nadir and at the Sun in turns. At noon, the motor of a wheel fails. An hour later, the flight software
# is told that the wheel is unavailable, and from then on commands only the other three.
import torch
from matplotlib import pyplot as plt

from bsk_torch import SatelliteTasking, act, craft, dyn, faults, fsw, obs, sats

# sphinx_gallery_thumbnail_number = 1
DAY = 86_400.0
NOON, TOLD = 43_200.0, 46_800.0

torch.set_num_threads(1)


class CubeSat(sats.Satellite):
    observation_spec = [obs.SatProperties(dict(prop="battery_charge_fraction"))]
    action_spec = [act.NadirPoint(duration=1800.0), act.Charge(duration=1800.0)]
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.SteeringFSWModel


broken = [
    faults.wheel_torque(0, at=NOON, name="motor"),
    faults.wheel_unavailable(0, at=TOLD, name="told"),
]
env = SatelliteTasking(
    CubeSat("SixU", {**craft.cubesat(), "faults": broken}),
    num_envs=1,
    seed=0,
    time_limit=DAY,
)
td = env.reset()
errors = []
with env.record(("Omega_WB_B", "motor_torque_B"), every=60) as recording:
    for k in range(int(DAY / 1800.0)):
        td = env.step(td.set("action", torch.tensor([k % 2])))["next"]
        body = env.satellite.dynamics
        trace = (body.BN @ body.HN.mT).diagonal(dim1=-2, dim2=-1).sum(-1)
        errors.append(torch.rad2deg(torch.acos((0.5 * (trace - 1.0)).clamp(-1.0, 1.0))))

# %%
# The picture shows the speeds of the four wheels, and the error at the end of each half hour of nadir pointing:
hours = recording.data["time"] / 3600.0
figure, (above, below) = plt.subplots(2, sharex=True, layout="constrained")
lines = above.plot(hours, recording.data["Omega_WB_B"] * 30.0 / torch.pi)
above.set_ylabel("wheel speed, rpm")
above.legend(
    lines,
    [f"wheel {k}" for k in range(4)],
    ncols=4,
    fontsize="small",
    loc="lower center",
    bbox_to_anchor=(0.5, 1.0),
)
nadir = torch.cat(errors[::2])
below.semilogy(torch.arange(len(nadir)) + 0.5, nadir, "o-")
below.set_ylabel("nadir error, degrees")
below.set_xlabel("time, hours")
for axes in (above, below):
    axes.axvline(NOON / 3600.0, color="gray", linestyle="--")
    axes.axvline(TOLD / 3600.0, color="gray", linestyle=":")
figure.savefig("day.png")

# %%
# Explanation
# -----------
#
# In the morning, four wheels turn at 1000 to 2200 rpm, two in each direction. There is one combination of speed changes of the
# four wheels that exerts no torque on the body, and null motion uses it to keep the speeds away from zero. The friction of the
# wheels is then constant, the integral term of the control law cancels it, and errors are below a thousandth of a degree.
#
# At noon, friction stops the broken wheel within minutes. The flight software still distributes each torque among four wheels.
# Because the part of the broken wheel is missing, torques act about a wrong axis, and the error is 14 degrees.
#
# From 13:00 on, errors are below two degrees, but not as small as in the morning. Null motion needs four wheels: with three, the
# momentum alone determines the speeds, and they pass through zero. At zero speed, friction changes its sign, and the integral
# term needs time to follow.
#
# The largest errors of each part of the day:
before, between, after = nadir[:12], nadir[12:13], nadir[13:]
for title, part in (("morning", before), ("failed", between), ("told", after)):
    if len(part):
        print(f"{title:8} up to {part.max():.4f} degrees")

# %%
# Next steps
# ----------
#
# - :ref:`tutorial-film`: films and figures of episodes.
# - The how-to guides "Describe a spacecraft", "Use a spacecraft of the library" and "Let parts fail".
