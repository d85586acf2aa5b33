"""Utilities of the drop-in."""

import logging
import math
from types import SimpleNamespace
from unittest.mock import MagicMock

import gymnasium
import numpy as np
import pytest

from bsk_torch.bsk_rl.basilisk.utilities import RigidBodyKinematics
from bsk_torch.bsk_rl.utils import attitude, functional, logging_config, orbital, rllib, vizard
from bsk_torch.bsk_rl.utils.actuator_primitives import balancedHR16Triad, idealMonarc1Octet
from bsk_torch.bsk_rl.utils.rllib import callbacks, discounting
from bsk_torch.sim import dyn, fsw, world

# -- functional ------------------------------------------------------------------------------------------------------------------


def test_default_arguments_are_collected_by_the_names_of_methods():
    class Model:
        @functional.default_args(b=[1, 2], c=3)
        def setup_z(self):
            """Anything."""

        @functional.default_args(a=1, c=3)
        def setup_a(self):
            """Anything."""

        @property
        def broken(self):
            raise RuntimeError

    found = functional.collect_default_args(Model)
    assert list(found.items()) == [("a", 1), ("c", 3), ("b", [1, 2])]
    assert functional.collect_default_args(Model()) == found
    found["b"].append(3)
    assert functional.collect_default_args(Model)["b"] == [1, 2]


def test_conflicts_of_dictionaries_warn():
    base = {"b": 2, "v": np.zeros(2)}
    with pytest.warns(UserWarning, match="Conflicting values for b: overwriting 2 with 4"):
        assert functional.safe_dict_merge({"a": 1, "b": 4, "v": np.zeros(2)}, base) is base
    assert (base["a"], base["b"]) == (1, 4)


def test_aliveness_is_that_of_all_checks():
    class Model:
        satellite = SimpleNamespace(logger=logging.getLogger("alive"))
        charge = 1.0

        @functional.aliveness_checker
        def battery_valid(self):
            return self.charge > 0.0

        @functional.aliveness_checker
        def always(self):
            return True

        @property
        def broken(self):
            raise RuntimeError

    model = Model()
    assert functional.check_aliveness_checkers(model)
    model.charge = 0.0
    assert not functional.check_aliveness_checkers(model)
    assert functional.is_property(model, "broken")
    assert not functional.is_property(model, "charge")


def test_a_failed_check_is_logged(caplog):
    class Model:
        satellite = SimpleNamespace(logger=logging.getLogger("dead"))

        @functional.aliveness_checker
        def fuel_remaining(self):
            """Whether fuel remains."""
            return False

    model = Model()
    assert not functional.check_aliveness_checkers(model, log_failure=True)
    assert caplog.messages == ["failed fuel_remaining check"]
    assert not model.fuel_remaining(log_failure=True)
    assert not model.fuel_remaining()
    assert caplog.messages == ["failed fuel_remaining check"] * 2
    assert Model.fuel_remaining.__doc__ == "Whether fuel remains."


def test_names_and_vectors():
    assert functional.valid_func_name("a-b c") == "a_b_c"
    assert functional.valid_func_name("1st") == "_1st"
    names, values = functional.vectorize_nested_dict({"a": 1, "b": np.array([2.0, 3.0]), "c": {"d": [4], "e": 5.0}})
    assert names == ["a", "b[0]", "b[1]", "c.d[0]", "c.e"]
    assert values.tolist() == [1, 2, 3, 4, 5]
    assert functional.vectorize_nested_dict({"a": [[1, 2], [3, 4]]})[1].shape == (2, 2)


def test_models_have_the_arguments_of_their_counterparts():
    found = functional.collect_default_args(dyn.ImagingDynModel)
    assert len(found) == 40
    assert found["mass"] == 330
    assert callable(found["wheelSpeeds"])
    assert functional.collect_default_args(fsw.ImagingFSWModel) == {}
    assert sorted(functional.collect_default_args(world.GroundStationWorldModel)) == [
        "groundLocationPlanetRadius", "groundStationsData", "gsMaximumRange", "gsMinimumElevation", "utc_init"
    ]  # fmt: skip


def test_places_have_their_components_first_and_elevations_are_numbers():
    places = orbital.lla2ecef(np.array([0.0, 90.0]), np.array([10.0, 20.0]), 2.0)
    assert places.shape == (3, 2)
    assert places[2].tolist() == pytest.approx([0.0, 2.0])
    assert isinstance(orbital.elevation(np.array([2.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])), float)


def test_classes_are_composed_without_repetitions():
    composed = functional.compose_types(dyn.ImagingDynModel, dyn.LOSCommDynModel, dyn.DynamicsModel, name="Dyn")
    assert composed.__bases__ == (dyn.ImagingDynModel, dyn.LOSCommDynModel)
    assert composed.__name__ == "Dyn(ImagingDynModel, LOSCommDynModel, DynamicsModel)"
    assert functional.mock_safe_bases(MagicMock(), int) == (object, int)


def test_an_abstract_attribute_must_be_defined():
    class Base:
        dyn_type = functional.AbstractClassProperty()

    class Child(Base):
        dyn_type = 3

    assert isinstance(Base.dyn_type, functional.AbstractClassProperty)
    assert Child().dyn_type == 3
    with pytest.raises(NotImplementedError, match=r"Base\.dyn_type must be defined"):
        _ = Base().dyn_type


def test_hooks_of_resets_do_nothing_by_default():
    part = functional.Resetable()
    for hook in ("overwrite_previous", "pre_sim_init", "during_sim_init", "post_sim_init"):
        assert getattr(part, f"reset_{hook}")() is None


# -- orbits ----------------------------------------------------------------------------------------------------------------------


def test_the_deprecated_altitude_of_an_orbit_still_counts(caplog):
    oe = orbital.random_orbit(alt=600, r_body=6400, e=0.3)
    assert (oe.a, oe.e, oe.omega) == (7e6, 0, 0)
    assert "random_circular_orbit" in caplog.text


def test_attitudes_are_converted_as_in_the_textbook():
    """Schaub and Junkins, Analytical Mechanics of Space Systems, example 3.2: (30, -45, 60) degrees of the sequence 3-2-1."""
    angles = np.radians([30.0, -45.0, 60.0])
    BN = [[0.612372, 0.353553, 0.707107], [-0.780330, 0.126826, 0.612372], [0.126826, -0.926777, 0.353553]]
    np.testing.assert_allclose(RigidBodyKinematics.euler3212C(angles), BN, atol=1e-6)
    np.testing.assert_allclose(RigidBodyKinematics.C2Euler321(BN), angles, atol=1e-5)
    np.testing.assert_allclose(RigidBodyKinematics.MRP2C(RigidBodyKinematics.C2MRP(BN)), BN, atol=1e-6)


@pytest.mark.parametrize(
    "name", ["EP", "MRP", "PRV", "Gibbs", *(f"Euler{sequence}" for sequence in RigidBodyKinematics.SEQUENCES)]
)
def test_representations_of_an_attitude_convert_back(name):
    q = np.array([0.8, 0.2, -0.4, 0.4])
    back = getattr(RigidBodyKinematics, f"{name.replace('Gibbs', 'gibbs').replace('Euler', 'euler')}2C")
    found = getattr(RigidBodyKinematics, f"C2{name}")(RigidBodyKinematics.EP2C(q))
    np.testing.assert_allclose(back(found), RigidBodyKinematics.EP2C(q), atol=1e-12)


def test_attitudes_compose_and_turn():
    first, second = np.array([0.1, 0.2, -0.3]), np.array([-0.4, 0.1, 0.2])
    total = RigidBodyKinematics.addMRP(first, second)
    np.testing.assert_allclose(
        RigidBodyKinematics.MRP2C(total), RigidBodyKinematics.MRP2C(second) @ RigidBodyKinematics.MRP2C(first), atol=1e-14
    )
    np.testing.assert_allclose(RigidBodyKinematics.subMRP(total, first), second, atol=1e-14)
    np.testing.assert_allclose(RigidBodyKinematics.MRPswitch([2.0, 0.0, 0.0], 1), [-0.5, 0.0, 0.0])
    rate, h = np.array([0.01, -0.02, 0.03]), 1e-6
    moved = (RigidBodyKinematics.C2MRP(RigidBodyKinematics.PRV2C(rate * h) @ RigidBodyKinematics.MRP2C(first)) - first) / h
    np.testing.assert_allclose(RigidBodyKinematics.dMRP(first, rate), moved, atol=1e-8)
    np.testing.assert_allclose(RigidBodyKinematics.dMRP2Omega(first, RigidBodyKinematics.dMRP(first, rate)), rate, atol=1e-15)


def test_constants_have_the_units_of_basilisk():
    om = orbital.orbitalMotion
    assert pytest.approx((6378.1366, 398600.436, 6356.7519), rel=1e-12) == (om.REQ_EARTH, om.MU_EARTH, om.RP_EARTH)
    for anomaly in (0.1, 2.0, 3.0, -1.0):
        E = om.f2E(anomaly, 0.4)
        assert om.E2f(E, 0.4) == pytest.approx(anomaly)
        assert om.M2E(om.E2M(E, 0.4), 0.4) == pytest.approx(E, abs=1e-12)
    r, v = om.elem2rv(om.MU_EARTH, om.ClassicElements(7000.0, 0.1, 1.0, 2.0, 0.5, 0.3))  # km
    back = om.rv2elem(om.MU_EARTH, r, v)
    assert (back.a, back.e, back.i, back.f) == pytest.approx((7000.0, 0.1, 1.0, 0.3))


def test_elevation_of_one_and_of_many_positions():
    target = np.array([6.4e6, 0.0, 0.0])
    assert orbital.elevation(2 * target, target) == pytest.approx(math.pi / 2, abs=1e-7)
    level = target + np.array([0.0, 1e5, 0.0])
    assert orbital.elevation(np.stack([2 * target, level]), target) == pytest.approx([math.pi / 2, 0.0], abs=1e-7)


# -- attitudes and wheels --------------------------------------------------------------------------------------------------------


def test_a_spin_adds_to_the_rate_of_the_hill_frame():
    r, v = [7e6, 0.0, 0.0], [0.0, 7500.0, 0.0]
    sigma, omega = attitude.hill_frame_attitude(r, v)
    np.testing.assert_allclose(sigma, 0.0, atol=1e-15)
    np.testing.assert_allclose(omega, [0.0, 0.0, 7500.0 / 7e6])
    _, spun = attitude.hill_frame_attitude(r, v, {"rate": 2.0, "axis": [0.0, 3.0, 0.0]})
    np.testing.assert_allclose(spun - omega, [0.0, math.radians(2.0), 0.0])


def test_wheels_give_their_speeds():
    assert balancedHR16Triad()[2] == [500, 500, 500]
    assert len(balancedHR16Triad(wheelSpeeds=[1, 2, 3])[-1]) == 3
    with pytest.raises(TypeError, match=r"wheelSpeeds=balancedHR16Triad\(...\)\[2\]"):
        _, _, _ = balancedHR16Triad()
    with pytest.raises(ImportError, match=r"act\.Desat"):
        idealMonarc1Octet()


# -- logs and pictures -----------------------------------------------------------------------------------------------------------


def test_lines_of_the_log_have_time_and_satellite():
    def line(name, message, **formatter):
        record = logging.LogRecord(name, logging.WARNING, "", 0, message, (), None)
        env = SimpleNamespace(unwrapped=SimpleNamespace(simulator=SimpleNamespace(sim_time=12.345)))
        assert logging_config.ContextFilter(env=env, proc_id=record.process).filter(record)
        assert not logging_config.ContextFilter(env=env, proc_id=-1).filter(record)
        return logging_config.SimFormatter(**formatter).format(record)

    said = line("bsk_torch.bsk_rl.sats.satellite.EO1", "failed", color_output=False)
    assert "sats.satellite.EO1" in said
    assert said.endswith("WARNING    <12.35> EO1: failed")
    assert line("bsk_torch.bsk_rl.gym", "=== STARTING STEP ===").count("\x1b[1m") == 0
    assert "\x1b[93;1m=== STARTING STEP ===\x1b[0m" in line("bsk_torch.bsk_rl.gym", "=== STARTING STEP ===")


def test_records_without_a_simulation_have_no_time():
    record = logging.LogRecord("bsk_torch.bsk_rl.gym", logging.INFO, "", 0, "text", (), None)
    assert logging_config.ContextFilter(proc_id=record.process).filter(record)
    assert "<" not in logging_config.SimFormatter(color_output=False).format(record)


def test_styles_of_text():
    assert logging_config.style_string("a", color="red", background_color="blue", bold=True) == "\x1b[91;104;1ma\x1b[0m"
    assert logging_config.style_string("a", no_format=True, bold=True) == "a"


def test_nothing_is_drawn_in_vizard():
    @vizard.visualize
    def draw(vizInstance=None):
        raise AssertionError

    assert draw() is None
    assert vizard.VIZARD_PATH is None
    assert vizard.get_color(3) is None


# -- RLlib -----------------------------------------------------------------------------------------------------------------------


def test_configurations_are_unpacked():
    class Env:
        def __init__(self, a, b=2):
            self.given = a, b

    made = rllib.unpack_config(Env)
    assert made({"a": 1}).given == (1, 2)
    assert made.__name__ == "Env_Unpacked"
    with pytest.raises(ImportError, match="from_checkpoint"):
        rllib.load_torch_mlp_policy("anywhere")


class Counter(gymnasium.Env):
    """An environment with satellites and a count of resets."""

    satellites = (SimpleNamespace(name="A", value=1.0), SimpleNamespace(name="B", value=3.0))
    resets = 0

    def reset(self, **kwargs):
        self.resets += 1
        return 0, kwargs


def test_metrics_are_given_to_the_logger_after_the_resets_of_rllib():
    env = callbacks.EpisodeDataWrapper(
        Counter(), lambda env: {"resets": env.resets}, lambda env, satellite: {"v": satellite.value}
    )
    logged = []
    env.set_metrics_logger(SimpleNamespace(log_value=lambda name, value, **_: logged.append((name, value))))
    for _ in range(3):
        env.reset(seed=1)
    assert not logged
    env.reset(seed=1)
    assert logged == [("resets", 3), ("A/v", 1.0), ("B/v", 3.0), ("mean/v", 2.0)]


def test_value_targets_of_steps_of_a_second_are_those_of_textbooks():
    values, rewards = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.5, 0.5, 1.0, 0.0])
    last, none = np.array([0, 0, 1, 0]), np.zeros(4)
    found = discounting.compute_value_targets_time_discounted(values, rewards, last, none, np.ones(4), 0.9, 0.0, "step_start")
    np.testing.assert_allclose(found, [0.5 + 0.9 * 2.0, 0.5, 1.0 + 0.9 * 4.0, 0.0], rtol=1e-6)  # one step ahead
    found = discounting.compute_value_targets_time_discounted(values, rewards, last, none, np.ones(4), 0.9, 1.0)
    np.testing.assert_allclose(found[2], 0.9 * 1.0)  # rewards come at the end of their steps
    np.testing.assert_allclose(found[0], 0.9 * (0.5 + 0.9 * (0.5 + 0.9 * 1.0)), rtol=1e-6)


def test_value_targets_discount_by_seconds():
    found = discounting.compute_value_targets_time_discounted(
        np.zeros(3), np.ones(3), np.zeros(3), np.array([0, 1, 0]), np.array([7.0, 10.0, 20.0]), 0.99, 0.5
    )
    np.testing.assert_allclose(found[0], 0.99**10.0 * (1.0 + 0.5 * 0.0), rtol=1e-6)  # the second step is truncated at value zero
    np.testing.assert_allclose(found[2], 0.99**20.0, rtol=1e-6)
