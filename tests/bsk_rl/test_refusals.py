"""Wrong calls of the drop-in: what each must raise, and what its message must name."""

from importlib import import_module
from types import SimpleNamespace

import numpy as np

from bsk_torch.bsk_rl import act, obs, sats
from bsk_torch.bsk_rl.basilisk.utilities import RigidBodyKinematics
from bsk_torch.bsk_rl.comm import LOSCommunication
from bsk_torch.bsk_rl.data import UniqueImageReward
from bsk_torch.bsk_rl.scene import UniformTargets
from bsk_torch.bsk_rl.utils import attitude, functional, orbital
from bsk_torch.bsk_rl.utils.rllib import callbacks, discounting
from bsk_torch.sim.dyn import ImagingDynModel
from tests.bsk_rl.fakes import Fake, begin, fleet
from tests.support.refusals import check_refusals, refusal


def test_rejects_names_that_nobody_has():
    modules = ("scene", "data", "utils.rso_imaging", "utils.rllib.callbacks")
    read = lambda module: import_module(f"bsk_torch.bsk_rl.{module}").no_such_name
    of_learner = [(discounting, name) for name in ("CondenseMultiStepActions", "TimeDiscountedGAEPPOTorchLearner")]
    unsupported = [*of_learner, (callbacks, "EpisodeDataCallbacks")]
    table = [
        *(refusal(lambda module=module: read(module), AttributeError, module, "no_such_name") for module in modules),
        refusal(lambda: RigidBodyKinematics.MRP2Q, AttributeError, "MRP2Q", "'MRP2C'"),
        *(refusal(lambda m=m, name=name: getattr(m, name), ImportError, name) for m, name in unsupported),
        *(refusal(lambda m=m: m.nothing, AttributeError, m.__name__, "'nothing'") for m, _ in unsupported),
    ]
    check_refusals(table)


def test_rejects_wrong_arguments_of_utilities():
    vector = lambda value: functional.vectorize_nested_dict({"a": 1, "b": {"c": value}})
    spin = lambda **config: attitude.hill_frame_attitude([7e6, 0.0, 0.0], [0.0, 7500.0, 0.0], config)
    chief = orbital.relative_to_chief("Chief", orbital.random_orbit, {})
    targets = discounting.compute_value_targets_time_discounted
    table = [
        *(refusal(lambda x=x: vector(x), TypeError, f"c={x!r}", "vector") for x in (None, "x", 1j, (1.0, 2.0))),
        refusal(lambda: chief([SimpleNamespace(name="Other")]), IndexError, ["Chief"], ["Other"]),
        refusal(lambda: spin(kind=1), ValueError, "spin_config", ["kind"]),
        refusal(lambda: spin(type="sometimes"), ValueError, "type", "'sometimes'", "'fixed'", "'uniform'"),
        refusal(lambda: spin(type="uniform", low=2.0, high=1.0), ValueError, "spin_config", "'low'", "'high'", 2.0, 1.0),
        refusal(lambda: spin(axis="up"), ValueError, "axis", "'up'", "'radial'"),
        refusal(lambda: spin(axis=[0.0, 0.0, 0.0]), ValueError, "spin_config['axis']", [0.0, 0.0, 0.0]),
        refusal(lambda: attitude.hill_frame_attitude([7e6, 0.0, 0.0], [1.0, 0.0, 0.0]), ValueError, "r_N", "v_N", "Hill frame"),
        refusal(lambda: attitude.hill_frame_attitude([7e6, 0.0], [1.0, 0.0, 0.0]), ValueError, "r_N", "v_N", (2,), (3,)),
        refusal(lambda: targets(*np.zeros((5, 1)), 0.9, 0.9, "middle"), ValueError, "reward_time", "'middle'", "'step_end'"),
    ]
    check_refusals(table)


def test_rejects_wrong_satellites():
    (satellite,), scenario, rewarder = fleet(1), UniformTargets(3), UniqueImageReward()
    scenario.link_satellites([satellite])
    rewarder.link_scenario(scenario)
    begin(rewarder, scenario, [satellite])
    satellite.levels[0] += 1.0
    blind = type("Blind", (Fake,), {"dyn_type": ImagingDynModel})("Blind")
    limits = ("imageTargetMinimumSunElevation", "imageTargetMaximumSunElevation")
    spec = {"observation_spec": [obs.Time()], "action_spec": [act.Image(n_ahead_image=2)]}
    imager = type("Imager", (sats.ImagingSatellite,), spec)
    table = [
        refusal(satellite.data_store.update_from_logs, AssertionError, "Sat0", "latest_target"),
        refusal(lambda: LOSCommunication().link_satellites([blind]), TypeError, "Blind", "ImagingDynModel", "LOSCommDynModel"),
        *(refusal(lambda name=name: imager("A", {name: 0.2}), ValueError, "sat_args", name, "windows") for name in limits),
    ]
    check_refusals(table)
    imager("A", dict.fromkeys(limits))
