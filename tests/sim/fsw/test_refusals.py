"""Gains that cannot be proposed, and commands of flight software that a satellite lacks."""

import math

import torch

from bsk_torch import SatelliteTasking, act, dyn, fsw, obs, sats
from bsk_torch.sim.fsw import steering
from tests.support.manoeuvring import Mover, make
from tests.support.refusals import check_refusals, refusal

AXES = torch.eye(3).tolist()


def test_rejects_gains_that_cannot_be_proposed():
    def propose(**arguments):
        wheels = [dyn.Wheel("Honeywell_HR16", axis, 50.0) for axis in AXES]
        return fsw.propose_gains(**dict(inertia=[82.0, 0, 0, 0, 98.0, 0, 0, 0, 121.0], wheels=wheels) | arguments)

    def body(*moments):
        return propose(inertia=torch.diag(torch.tensor(moments, dtype=torch.float64)).flatten().tolist())

    two = [dyn.Wheel("Honeywell_HR16", axis, 50.0) for axis in AXES[:2]]
    endless = [dyn.Wheel("BCT_RWP015", axis, useMaxTorque=False) for axis in AXES]
    dependent = {"controlAxes_B": torch.zeros(1, 9)}
    check_refusals(
        refusal(lambda: propose(wheels=[]), ValueError, "propose_gains", "wheels=[]", "dyn.Wheel"),
        refusal(lambda: propose(wheels=two), ValueError, "wheels", "2 of 3 dimensions"),
        refusal(lambda: propose(inertia=[1.0, 2.0, 3.0]), ValueError, "inertia=[1.0, 2.0, 3.0]", "9 numbers", "3 x 3"),
        refusal(lambda: propose(inertia=[math.nan] * 9), ValueError, "inertia=[nan, ", "9 numbers", "3 x 3"),
        refusal(lambda: propose(inertia="box"), ValueError, "inertia='box'", "9 numbers", "3 x 3"),
        refusal(lambda: body(10.0, 20.0, 31.0), ValueError, "inertia=[10.0, ", "[10.0, 20.0, 31.0]"),
        refusal(lambda: body(0.05, 0.05, 0.05), ValueError, "inertia=[0.05, ", "wheels", "0.0796, 0.0796, 0.0796 kg m^2"),
        refusal(lambda: propose(law="feedbak"), ValueError, "law='feedbak'", "'feedback'"),
        refusal(lambda: propose(h=0.0), ValueError, "propose_gains", "h=0.0"),
        refusal(lambda: propose(slew=4.0), ValueError, "propose_gains", "slew=4.0"),
        refusal(lambda: propose(thrusters=["MOOG"]), ValueError, "thrusters=['MOOG']", "dyn.Thruster"),
        refusal(lambda: propose(wheels=endless), ValueError, "wheel 0", "u_max=-1"),
        refusal(lambda: steering.MRP_STEERING.check(dependent), ValueError, "controlAxes_B", "three independent axes"),
    )


def test_rejects_actions_that_the_satellite_cannot_execute():
    class Debris(sats.Satellite):
        observation_spec, action_spec = (obs.Time(),), (act.NadirPoint(),)
        dyn_type, fsw_type = dyn.DynamicsModel, fsw.TumblingFSWModel

    class NoTank(Mover):
        fsw_type, observation_spec = fsw.FSWModel, Mover.observation_spec[1:]

    debris = Debris("Debris")
    check_refusals(
        refusal(lambda: SatelliteTasking(debris, backend="eager"), ValueError, "fsw_action='nadir_point'", "fsw.FSWModel"),
        refusal(lambda: make(kind=NoTank), ValueError, "act.Kick()", "tank", "fsw.MagicOrbitalManeuver"),
    )
