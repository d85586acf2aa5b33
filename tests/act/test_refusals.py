"""Wrong calls of actions: what each must raise, and what its message must name."""

import math

from bsk_torch import ConstellationTasking, act, data, dyn, fsw, scene
from bsk_torch.act.waypoint import HillWaypoint
from bsk_torch.tasks.objects import ImageRSO
from tests.act import test_image_strip as strips
from tests.act import test_thrust as thrusts
from tests.act import test_waypoint as waypoints
from tests.support.refusals import check_refusals, refusal
from tests.tasks.objects.objects import environment


def test_rejects_wrong_strips():
    targets, reward = scene.UniformTargets(2), data.StripImageReward
    make = lambda **options: strips.make(backend="eager", **options)
    models = dict(dyn_type=dyn.ImagingDynModel, fsw_type=fsw.ImagingFSWModel)
    plain = type("Plain", (strips.StripImager,), dict(action_spec=(act.Image(4),)) | models)
    table = [
        *(
            refusal(lambda x=x: scene.StripTargets(targets, x), ValueError, "length", f"{x:g}", "target 0", "[1, 1e+07]")
            for x in (0.0, -1.0, math.nan, 2e7)
        ),
        refusal(lambda: scene.StripTargets(3), ValueError, "targets=3"),
        refusal(lambda: scene.StripTargets(targets, acquisition_speed=0.0), ValueError, "acquisition_speed=0.0", "m/s"),
        refusal(lambda: act.ImageStrip(4, -1.0), ValueError, "pre_imaging_time=-1.0", "[0, 100000]"),
        refusal(lambda: act.ImageStrip(0), ValueError, "n_ahead_image=0"),
        refusal(lambda: act.HybridImageStrip(4, 0.0), ValueError, "max_duration=0.0", "(0, 100000]"),
        refusal(lambda: reward(1.5), ValueError, "fraction=1.5", "(0, 1]"),
        refusal(lambda: reward(math.nan), ValueError, "fraction=nan"),
        refusal(lambda: make(scenario=scene.UniformTargets(9)), ValueError, "action_image_strip", "scene.StripTargets"),
        refusal(lambda: make(kind=plain, rewarder=reward()), ValueError, "StripImageReward", "fsw.StripImaging"),
    ]
    check_refusals(table)


def test_rejects_wrong_imaging_of_objects():
    image = lambda **given: ImageRSO(**({"n_ahead_image": 3} | given))
    imager = lambda **args: environment(sat_args=args, backend="eager")
    table = [
        refusal(lambda: image(n_ahead_image=0), ValueError, "n_ahead_image=0"),
        refusal(lambda: image(n_ahead_image=2.5), ValueError, "n_ahead_image=2.5"),
        refusal(lambda: image(max_duration=0.0), ValueError, "max_duration=0.0"),
        refusal(lambda: image(min_pointing_hold_s=-1.0), ValueError, "min_pointing_hold_s=-1.0"),
        refusal(lambda: image(min_pointing_hold_s=60.0, max_duration=60.0), ValueError, "hold_s=60.0", "max_duration=60.0"),
        refusal(lambda: image(hold_mode="cumulativ"), ValueError, "hold_mode='cumulativ'", "'cumulative'"),
        refusal(lambda: image(hold_illumination_threshold=1.5), ValueError, "hold_illumination_threshold=1.5"),
        refusal(lambda: image(require_illumination_during_hold=2), ValueError, "require_illumination_during_hold=2"),
        refusal(lambda: image(variable_duration_imaging=None), ValueError, "variable_duration_imaging=None"),
        refusal(lambda: imager(imageTargetMaximumRange=0.0), ValueError, "imageTargetMaximumRange=0"),
        refusal(lambda: imager(instrumentBaudRate=1.5), ValueError, "instrumentBaudRate=1.5"),
        refusal(lambda: imager(instrumentBaudRate=0.0), ValueError, "instrumentBaudRate=0"),
    ]
    check_refusals(table)


def test_rejects_wrong_thrusts():
    make, thrust = thrusts.make, act.ImpulsiveThrust
    dry = dyn.DynamicsModel, fsw.FSWModel
    table = [
        refusal(lambda: make(thrust(max_dv=0.0)), ValueError, "max_dv=0.0"),
        refusal(lambda: make(thrust(max_drift_duration=-1.0)), ValueError, "max_drift_duration=-1.0"),
        refusal(lambda: make(thrust(max_drift_duration=2.0)), ValueError, "max_drift_duration=2", "2 ticks", "2 s"),
        refusal(lambda: make(thrust(fsw_action="nadir")), ValueError, "'nadir'", "'nadir_point'"),
        refusal(lambda: make(thrust(fsw_action=3)), ValueError, "fsw_action=3"),
        refusal(lambda: make(act.Charge(), models=dry), ValueError, "fsw_action='charge'", "fsw.BasicFSWModel"),
        refusal(lambda: make(act.ImpulsiveThrustHill("B")), ValueError, "chief_name='B'"),
        refusal(lambda: make(act.ImpulsiveThrustHill(3)), ValueError, "chief_name=3"),
        refusal(lambda: make(act.AttitudeSetpoint(control_period=0.0)), ValueError, "control_period=0.0"),
        refusal(lambda: make(thrust(), models=dry), ValueError, "ImpulsiveThrust", "'thrust_act'", "tank"),
    ]
    check_refusals(table)


def test_rejects_wrong_waypoints():
    waypoint = lambda **given: HillWaypoint(**(dict(chief_name="C") | given))
    chief, dry = waypoints.kind("Chief", act.Drift()), waypoints.kind("Dry", waypoint(), fsw_type=fsw.FSWModel)
    table = [
        refusal(lambda: waypoint(waypoints=0), ValueError, "waypoints=0", 1),
        refusal(lambda: waypoint(waypoints=[[1.0, 2.0]]), ValueError, "waypoints", "[D, 3]", [1, 2]),
        refusal(lambda: waypoint(waypoints=[[1.0, 2.0, math.nan]]), ValueError, "waypoints", "finite positions"),
        refusal(lambda: waypoint(durations=[]), ValueError, "durations=[]"),
        refusal(lambda: waypoint(durations=[600.0, 0.0]), ValueError, "durations=0.0"),
        refusal(lambda: waypoint(distance=-1.0), ValueError, "distance=-1.0"),
        refusal(lambda: waypoint(max_dv=0.0), ValueError, "max_dv=0.0"),
        refusal(lambda: waypoint(keep_out=-1.0), ValueError, "keep_out=-1.0"),
        refusal(lambda: waypoint(keep_out=20.0, keep_in=10.0), ValueError, "keep_in=10.0"),
        refusal(lambda: waypoint(keep_apart=math.inf), ValueError, "keep_apart=inf"),
        refusal(lambda: waypoint(chief_name=3), ValueError, "chief_name=3"),
        refusal(lambda: waypoints.make(HillWaypoint("B")), ValueError, "chief_name='B'"),
        refusal(lambda: waypoints.make(HillWaypoint("D2"), ("D1", "D2")), ValueError, "chief_name='D2'", "type"),
        refusal(lambda: waypoints.make(waypoint(fsw_action="nadir")), ValueError, "'nadir'", "'nadir_point'"),
        refusal(lambda: ConstellationTasking([chief("C"), dry("D1")], backend="eager"), ValueError, "'waypoint'", "tank"),
    ]
    check_refusals(table)
