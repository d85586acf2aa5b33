"""Every law that recordings of Basilisk check is replayed before a change lands; the other recordings are replayed at night."""

import itertools

import pytest

from tests.basilisk import test_constellation_parity as constellations
from tests.basilisk import test_imaging_parity as images
from tests.basilisk import test_manoeuvres as manoeuvres
from tests.basilisk import test_models_parity as models
from tests.basilisk import test_parity as scanning
from tests.basilisk import test_relative_parity as relative
from tests.basilisk import test_setpoint_parity as setpoints
from tests.examples import test_bsk_rl as examples
from tests.support.levels import level, read_durations
from tests.tasks.aeos_bench import test_recordings as aeos_bench
from tests.tasks.inspection import test_recordings as inspection

LAWS = {
    "orbits on arcs": [(scanning.test_arc, "nominal")],
    "orbits integrated with drag": [(scanning.test_integrated, "low")],
    "eccentric orbits, eclipses and passes": [(scanning.test_eccentric,)],
    "feedback of attitude, with its integral and the limit of it": [
        (scanning.test_other_laws, "integral"),
        (scanning.test_other_laws, "integral_clip"),
    ],
    "all modes of scanning": [(scanning.test_other_laws, "all_modes")],
    "saturated wheels and desaturation": [(scanning.test_arc, name) for name in ("saturation", "desat_sun", "desat_none")],
    "a full store": [(scanning.test_arc, "full"), (images.test_feedback, "full")],
    "other ticks": [(scanning.test_other_ticks, "half_second"), (scanning.test_other_ticks, "two_seconds")],
    "ticks of the eager back end": [(scanning.test_ticks, "arc"), (images.test_eager_first_steps,)],
    "the steering law": [(images.test_steering,)],
    "images, windows and passes of targets": [(images.test_feedback, "feedback"), (images.test_look_ahead_of_days,)],
    "lines of sight and ranges of radio": [(constellations.test_constellation, name) for name in ("los", "range", "multi")],
    "communication at the end of steps, free and broadcast": [
        (constellations.test_constellation, name) for name in ("free", "broadcast")
    ],
    "types of satellites in one episode, deaths": [(constellations.test_constellation, name) for name in ("types", "death")],
    "meta-agents and joint agents": [(constellations.test_constellation, name) for name in ("meta", "joint")],
    "satellites without tasks, shared images": [(constellations.test_constellation, name) for name in ("untasked", "shared")],
    "manoeuvres on arcs": [(manoeuvres.test_manoeuvres_against_basilisk, "manoeuvre_kick", "arc")],
    "manoeuvres of integrated orbits": [(examples.test_continuous_orbit_maneuvers,)],
    "inspection, by points, light and completion": [
        (inspection.test_an_episode_is_the_recorded_one, case) for case in ("complete", "dark")
    ],
    "inspection, ended by fuel, range and collision": [
        (inspection.test_an_episode_is_the_recorded_one, case) for case in ("fuel", "range", "collision", "collide3")
    ],
    "inspection with the steering law": [(examples.test_rso_inspection,)],
    "three inspectors": [(inspection.test_an_episode_is_the_recorded_one, "three")],
    "encounters that end steps": [
        (relative.test_recorded_steps_end_with_the_first_encounter_and_bookings_are_bsk_rls, f"inspection_{case}")
        for case in ("collide3", "range")
    ],
    "attitudes by set-points": [(setpoints.test_set_points, "compiled", name) for name in setpoints.BOUNDS],
    "imposed attitudes, passive satellites": [
        (models.test_an_attitude_without_actuators_is_that_of_the_last_reference,),
        (models.test_an_imposed_attitude_is_the_same_in_kernels,),
        (models.test_wheels_turn_beside_passive_satellites_and_without_stations,),
    ],
    "the tick of AEOS-Bench": [
        *((aeos_bench.test_a_tick_from_every_recorded_state, "compiled", name) for name in ("random", "odd", "stiff")),
        *((aeos_bench.test_a_flight, "compiled", name) for name in aeos_bench.NAMES),
    ],
}
"""Replays of each law: a test, and the values of its parameters."""


def cases_of(test):
    """Values of the parameters of a test, in the order of its decorators from the lowest one."""
    lists = [mark.args[1] for mark in getattr(test, "pytestmark", []) if mark.name == "parametrize"]
    values = [[case if isinstance(case, tuple) else (case,) for case in cases] for cases in lists]
    return [tuple(itertools.chain(*case)) for case in itertools.product(*values)]


@pytest.mark.parametrize("law", LAWS)
def test_every_law_is_replayed_before_a_change_lands(law):
    durations = read_durations()
    assert LAWS[law]
    for test, *case in LAWS[law]:
        assert tuple(case) in cases_of(test)
        name = f"{test.__module__.replace('.', '/')}.py::{test.__name__}" + (f"[{'-'.join(case)}]" if case else "")
        assert level(name, durations, getattr(test, "pytestmark", [])) != "nightly", f"{name} runs at night only"
