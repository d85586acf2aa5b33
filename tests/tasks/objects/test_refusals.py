"""Resident space objects (RSO): wrong objects, catalogs and their files, and scenarios."""

from __future__ import annotations

import json
import math

from bsk_torch import rand, scene
from bsk_torch.tasks.inspection import SphericalRSO
from bsk_torch.tasks.objects import RandomRSOCatalog, RSOMixture, RSOPriorityEvent, RSOTarget, RSOTargetCatalog, RSOTargets
from tests.support.refusals import check_refusals, refusal
from tests.tasks.objects.objects import EPOCH, catalog, environment, state

R_N, V_N = state(0.1)


def target(**changes):
    return RSOTarget(**({"id": "a", "satellite_name": "A", "rN": R_N, "vN": V_N} | changes))


def event(*priorities, time=0.0):
    return RSOPriorityEvent(time, priorities)


def test_rejects_wrong_objects():
    def physical(*values):
        return target(physical_parameters=values)

    def points(**options):
        return SphericalRSO(**options)

    name = "RSOTarget('a')"
    check_refusals(
        [
            refusal(lambda: target(id=""), ValueError, "RSOTarget", "id", "''"),
            refusal(lambda: target(satellite_name=3), ValueError, name, "satellite_name=3"),
            refusal(lambda: target(rN=[1.0, 2.0]), ValueError, name, "rN", [1.0, 2.0]),
            refusal(lambda: target(vN=[math.nan, 0.0, 0.0]), ValueError, name, "vN", "[nan, 0.0, 0.0]"),
            refusal(lambda: target(rN=[6.0e6, 0.0, 0.0]), ValueError, name, "4351 km", "6748 km"),
            refusal(lambda: target(rN=[7000.0, 0.0, 0.0]), ValueError, name, "0 km", "rN in m"),
            refusal(lambda: target(priority=-1.0), ValueError, name, "priority", -1.0),
            refusal(lambda: target(priority=math.nan), ValueError, name, "priority", "nan"),
            refusal(lambda: physical(("masss", 1.0)), ValueError, name, "physical_parameters", "'masss'", "'mass'"),
            refusal(lambda: physical(("mass", 0.0)), ValueError, name, "mass", 0.0),
            refusal(lambda: physical(("mass", 1.0), ("mass", 2.0)), ValueError, name, "physical_parameters", "'mass'"),
            refusal(lambda: points(n_points=0), ValueError, "n_points=0"),
            refusal(lambda: points(radius=0.0), ValueError, "radius", 0.0),
            refusal(lambda: points(theta_max=45.0), ValueError, "theta_max", 45.0),
            refusal(lambda: points(range_max=math.nan), ValueError, "range_max", "nan"),
            refusal(lambda: points(min_illumination_factor=1.5), ValueError, "min_illumination_factor", 1.5),
        ]
    )


def test_rejects_wrong_catalogs():
    def of(*targets, **options):
        return RSOTargetCatalog(targets, **options)

    def saved(**changes):
        return RSOTargetCatalog.from_dict(catalog().to_dict() | changes)

    def drawn(n=3, **options):
        return RandomRSOCatalog(n, **options)

    without = {name: value for name, value in catalog().to_dict().items() if name != "targets"}
    late = (event(("object 0", 1.0), time=5.0), event(("object 0", 1.0), time=1.0))
    check_refusals(
        [
            refusal(of, ValueError, "targets", "0 entries", 1000),
            refusal(lambda: of(target(), target(satellite_name="B")), ValueError, "ids", ["a"]),
            refusal(lambda: of(target(), target(id="b")), ValueError, "satellite names", ["A"]),
            refusal(lambda: of(target(), utc_init="yesterday"), ValueError, "utc_init", "'yesterday'"),
            refusal(lambda: RSOTargetCatalog(["a"]), ValueError, "targets", ["a"], "RSOTarget"),
            refusal(lambda: of(target(), priority_events=(event(("b", 1.0)),)), ValueError, "RSOPriorityEvent", "'b'", ": a"),
            refusal(lambda: event(time=-1.0), ValueError, "time_s", -1.0),
            refusal(lambda: event(("a", math.nan)), ValueError, "priorities", "'a'", "nan"),
            refusal(lambda: event(("a", 1.0), ("a", 2.0)), ValueError, "RSOPriorityEvent", ["a"]),
            refusal(lambda: catalog(priority_events=late), ValueError, "priority_events", [5.0, 1.0]),
            refusal(lambda: saved(frame="ECEF"), ValueError, "frame", "'ECEF'", "'Earth-centered J2000'"),
            refusal(lambda: RSOTargetCatalog.from_dict(without), ValueError, "targets", None),
            refusal(lambda: drawn(0), ValueError, "n_targets=0"),
            refusal(lambda: drawn(oe=[rand.random_orbit()] * 2), ValueError, "oe", "2 distributions", "3 targets"),
            refusal(lambda: drawn(oe="low"), ValueError, "oe", "'low'"),
            refusal(lambda: drawn(priority=math.nan), ValueError, "priority", "nan"),
            refusal(lambda: drawn(priority=[1.0, 2.0]), ValueError, "priority", [1.0, 2.0], "3 targets"),
            refusal(lambda: drawn(priority_events=[event(("a", 1.0))]), ValueError, "'a'", "rso-0, rso-1, rso-2"),
            refusal(lambda: drawn(200, priority_events=[event(("zz", 1.0))]), ValueError, "'zz'", "200 targets", "'rso-2'"),
            refusal(lambda: drawn(priority_sum=-1.0), ValueError, "priority_sum", -1.0),
            refusal(lambda: RSOMixture((0.5, 0.3)), ValueError, "shares", (0.5, 0.3)),
            refusal(lambda: RSOMixture((0.5, 0.3, 0.3)), ValueError, "shares", 1.1),
            refusal(lambda: RSOMixture((1.5, -0.5, 0.0)), ValueError, "shares", 1.5),
            refusal(lambda: RSOMixture("leo"), ValueError, "'leo'", "'LEO'"),
            refusal(lambda: RSOMixture(exact=2), ValueError, "exact=2"),
        ]
    )


def test_rejects_wrong_catalog_files(tmp_path):
    path = tmp_path / "objects.json"

    def load(text):
        path.write_text(text)
        return RSOTargetCatalog.load(path)

    def changed(**entries):
        return load(json.dumps(catalog().to_dict() | entries))

    misspelled, first = catalog().to_dict()["targets"][0] | {"prioritee": 1.0}, "entry 0 of targets"
    timed = [{"time_s": 1.0}]
    check_refusals(
        [
            refusal(lambda: load("[1, 2]"), ValueError, path, "dictionary", "list"),
            refusal(lambda: changed(targets=5), ValueError, path, "targets=5", "dictionaries"),
            refusal(lambda: changed(targets=[5]), ValueError, path, "targets", [5], "dictionaries"),
            refusal(lambda: changed(targets=[misspelled]), ValueError, path, first, "'prioritee'"),
            refusal(lambda: changed(targets=[{"id": "a"}]), ValueError, path, first, ["satellite_name", "rN", "vN"]),
            refusal(lambda: changed(priority_events=timed), ValueError, path, "entry 0 of priority_events", ["priorities"]),
            refusal(lambda: changed(utc_init=5), ValueError, path, "utc_init=5"),
            refusal(lambda: load("{bad"), ValueError, path, "line 1 column 2"),
        ]
    )


def test_rejects_wrong_scenarios_of_objects():
    def of(catalog, names=("A",), **options):
        return RSOTargets(catalog, names, **options)

    known, later, nadir = catalog(), "2021 JUN 06 09:12:05.830 (UTC)", scene.UniformNadirScanning()
    low = RandomRSOCatalog(3, oe=rand.random_orbit(a=7000.0, e=0.2))

    def fly(catalog=None, **options):
        return environment(catalog=catalog, backend="eager", **options)

    fly(catalog(utc_init=EPOCH)).reset()
    check_refusals(
        [
            refusal(lambda: of(known, []), ValueError, "imager_names", []),
            refusal(lambda: of(known, "Imager0"), ValueError, "imager_names", "'Imager0'"),
            refusal(lambda: of(known, ["A", "A"]), ValueError, "imager_names", ["A", "A"]),
            refusal(lambda: of([known]), ValueError, "catalog", "RSOTargetCatalog"),
            refusal(lambda: of(rand.per_env([known, catalog((0.1, 0.2))])), ValueError, "rand.per_env", "ids"),
            refusal(lambda: of(known, block_pending_targets=2), ValueError, "block_pending_targets=2"),
            refusal(lambda: fly(catalog(utc_init=later)), ValueError, "environment 0", later, "world_args"),
            refusal(lambda: fly(low), ValueError, "oe", "5600 km", "6748 km"),
            refusal(lambda: fly(scenario=nadir, rewarder=None), ValueError, "ImageRSO", "RSOTargets"),
        ]
    )
