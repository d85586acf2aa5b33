"""Catalogs of resident space objects (RSO), and the scenario of their imaging."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from bsk_torch import rand
from bsk_torch.astro.ephemeris import parse_utc
from bsk_torch.tasks.objects import RandomRSOCatalog, RSOPriorityEvent, RSOTarget, RSOTargetCatalog, RSOTargets
from bsk_torch.tasks.objects.scene import epoch_text, partition_name
from tests.support.episodes import begun
from tests.support.refusals import check_refusals, refusal
from tests.tasks.objects.objects import EPOCH, catalog, environment, play, state

R_N, V_N = state(0.1)


def target(**changes):
    return RSOTarget(**({"id": "a", "satellite_name": "A", "rN": R_N, "vN": V_N} | changes))


def test_catalogs_and_epochs_are_saved_and_loaded_without_rounding(tmp_path):
    events = (RSOPriorityEvent(60.0, (("object 1", 0.5),)),)
    wanted = catalog(utc_init=EPOCH, priority_events=events)
    wanted.save(tmp_path / "catalog.json")
    assert RSOTargetCatalog.load(tmp_path / "catalog.json") == wanted
    assert json.loads((tmp_path / "catalog.json").read_text())["schema_version"] == 1
    for et in (parse_utc(EPOCH), 123456789.25, -3.5e7, 0.0):
        assert parse_utc(epoch_text(et)) == et
    assert dict(target(physical_parameters=(("mass", 12.0),)).physical_parameters)["mass"] == 12.0
    assert dict(target().physical_parameters)["mass"] == 330.0


def test_old_names_of_satellites_are_read():
    values = catalog().to_dict()
    for saved in values["targets"]:
        saved["spacecraft_name"] = saved.pop("satellite_name")
    assert RSOTargetCatalog.from_dict(values) == catalog()
    values["targets"][0]["satellite_name"] = "other"
    check_refusals(refusal(lambda: RSOTargetCatalog.from_dict(values), ValueError, "satellite_name", "spacecraft_name"))


def test_imagers_must_be_there_and_able():
    def fly(*imagers, **options):
        return environment(scenario=RSOTargets(catalog(), imagers), backend="eager", **options)

    named = RSOTargetCatalog((target(satellite_name="Imager0"),))
    model = "SpaceToSpaceImagingDynModel"
    check_refusals(
        refusal(lambda: fly("Imager7"), ValueError, "imager_names", "'Imager7'", "'Imager0'"),
        refusal(lambda: fly("Imager0", imagers=2), ValueError, "imager_names", ["Imager1"], model),
        refusal(lambda: environment(catalog=named, backend="eager"), ValueError, "catalog", ["Imager0"]),
    )


@pytest.mark.compiled
def test_stores_and_candidates_are_named_after_targets():
    env = environment()
    assert env.satellites[0].sat_args["bufferNames"] == [partition_name(key) for key in env.scenario.ids]
    assert partition_name("object 0").startswith("rso_")
    assert len(partition_name("object 0")) == 4 + 32
    env = begun(environment())
    assert env.scenario.candidate_ids(env.satellites[0], 0, 5) == ["object 1", "object 2", "object 0", "object 3", None]


@pytest.mark.compiled
def test_targets_begin_where_the_catalog_says_and_priorities_change():
    events = (RSOPriorityEvent(0.0, (("object 0", 9.0),)), RSOPriorityEvent(100.0, (("object 1", 7.0),)))
    env = begun(environment(catalog=catalog(priority_events=events)))
    wanted = torch.tensor([part.rN for part in catalog().targets], dtype=torch.float64)
    assert (env.scenario.r_TN_N - wanted).abs().max() < 1e-6
    assert env.scenario.priority[0].tolist() == [9.0, 2.0, 3.0, 4.0]
    for _ in range(2):
        play(env, 0)
    assert env.scenario.priority[0].tolist() == [9.0, 7.0, 3.0, 4.0]


@pytest.mark.compiled
def test_random_catalogs_differ_between_episodes_but_not_with_the_batch():
    mixture = [rand.random_orbit(a=7200.0)] * 3 + [rand.random_orbit(a=26560.0, e=0.01)] * 2
    drawn = RandomRSOCatalog(5, oe=mixture, priority=rand.Uniform(1.0, 2.0))

    def begin(n, **options):
        return begun(environment(catalog=drawn, num_envs=n, **options))

    few, many = begin(2), begin(5)
    assert torch.equal(few.scenario.r_TN_N, many.scenario.r_TN_N[:2])
    assert not torch.equal(many.scenario.r_TN_N[0], many.scenario.r_TN_N[1])
    radius = many.scenario.r_TN_N.norm(dim=-1)
    assert (radius[:, :3] < 7.3e6).all()
    assert (radius[:, 3:] > 2.6e7).all()
    assert ((many.scenario.priority >= 1.0) & (many.scenario.priority < 2.0)).all()


@pytest.mark.compiled
def test_priorities_may_come_from_a_function():
    env = begun(environment(catalog=RandomRSOCatalog(3, priority=lambda: float(np.random.uniform(5.0, 6.0)))))
    assert ((env.scenario.priority >= 5.0) & (env.scenario.priority < 6.0)).all()
    assert not torch.equal(env.scenario.priority[0], env.scenario.priority[1])


@pytest.mark.compiled
def test_the_catalog_of_an_episode_can_be_flown_again(tmp_path):
    env = begun(environment(catalog=RandomRSOCatalog(3)))
    env.scenario.catalog_of(1).save(tmp_path / "catalog.json")
    again = RSOTargetCatalog.load(tmp_path / "catalog.json")
    assert again.utc_init is not None
    other = begun(environment(catalog=again, world_args={"utc_init": again.utc_init}))
    assert torch.equal(other.scenario.r_TN_N[0], env.scenario.r_TN_N[1])
    named = environment().scenario.catalogs[0]
    assert dataclasses.replace(named, utc_init=None) == named


@pytest.mark.compiled
def test_candidates_are_in_sight_unless_the_earth_or_the_range_is_in_the_way():
    def seen(**args):
        env = begun(environment(imagers=2, sat_args=args))
        scout = env.satellites[0]
        candidates = env.scenario.candidates(scout, 5)
        found = zip(candidates.place[0].tolist(), env.scenario.in_sight(scout, candidates)[0].tolist(), strict=True)
        return [place for place, free in found if free]

    assert seen() == [1, 2, 0]  # object 3 is on the other side of the Earth
    assert (seen(imageTargetMaximumRange=6e5), seen(imageTargetMaximumRange=1e3)) == ([2, 0], [])
