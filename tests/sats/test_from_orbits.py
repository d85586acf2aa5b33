"""Satellites from files of orbits, in environments: positions, epochs, names."""

import numpy as np
import pytest
import torch
from skyfield.api import EarthSatellite, load
from tensordict.nn import TensorDictModule

from bsk_torch import act, data, dyn, fsw, obs, rand, sats
from bsk_torch.astro.ephemeris import DAY, date_in_words, parse_utc
from bsk_torch.env import ConstellationTasking, SatelliteTasking
from bsk_torch.formats.orbits import read_orbits
from bsk_torch.sim.orbit.grid import LEAD_NODES
from tests.formats.samples import EPOCH, FLEET, GREENSAT, OMM_JSON, OPM
from tests.support.refusals import check_refusals, refusal


class Drifter(sats.Satellite):
    observation_spec = (obs.Time(),)
    action_spec = (act.Drift(duration=5.0),)
    dyn_type = dyn.BasicDynamicsModel
    fsw_type = fsw.BasicFSWModel


def team(source=FLEET, epoch=EPOCH, num_envs=2, **options):
    satellites = source if isinstance(source, list) else Drifter.from_tle(source)
    options = {"world_args": {"utc_init": epoch}, "max_step_duration": 5.0, "backend": "eager", "seed": 1} | options
    return ConstellationTasking(satellites, None, data.NoReward(), num_envs=num_envs, **options)


def skyfield_positions(text, et):
    """Positions in GCRS of the sets of a text at ET, [S, 3] m."""
    timescale = load.timescale(builtin=True)
    lines = [line for line in text.splitlines() if line[:2] in ("1 ", "2 ")]
    time = timescale.tdb_jd(2451545.0, et / DAY)
    return np.stack([EarthSatellite(*lines[k : k + 2], None, timescale).at(time).position.m for k in range(0, len(lines), 2)])


@pytest.mark.parametrize(("orbit", "starts", "later"), [(None, 1.0, 1.5e3), ("sgp4", 1.0, 1.0)])
def test_satellites_are_where_sgp4_puts_them(orbit, starts, later):
    env = team(orbit=orbit)
    env.reset()
    simulator = env.fleet.simulators[0]
    arcs, now = simulator.arcs, simulator.sim_time
    simulator.lookahead.reach(now + 22000.0, now)
    et = float(arcs.et[0])
    assert date_in_words(et) == EPOCH.replace("Z", ".000Z")
    for hours, bound in (
        (0, starts),
        (6, later),
    ):  # the worst of 20 satellites is 0.92 km; without the fit of the velocity, 3.2 km
        found = arcs.flown[:3, LEAD_NODES + 60 * hours].numpy()
        assert np.linalg.norm(found - skyfield_positions(FLEET, et + 3600.0 * hours), axis=-1).max() < bound


def test_each_environment_has_its_own_epoch():
    days = ("2026-04-14T00:00:00Z", "2026-04-15T12:30:00Z")
    env = team(GREENSAT, rand.per_env(list(days)), num_envs=2)
    env.reset()
    arcs = env.fleet.simulators[0].arcs
    for k, day in enumerate(days):
        assert float(arcs.et[k]) == parse_utc(day)
        assert np.linalg.norm(arcs.flown[k, LEAD_NODES].numpy() - skyfield_positions(GREENSAT, float(arcs.et[k]))) < 1.0
    alone = team(GREENSAT, rand.per_env(list(days)), num_envs=1, env_ids=[1])
    alone.reset()
    assert torch.equal(alone.fleet.simulators[0].arcs.flown[0], arcs.flown[1])


def test_episodes_draw_among_orbits():
    sets = read_orbits(FLEET)
    satellite = Drifter("A", {"oe": rand.Choice(sets)})
    env = SatelliteTasking(satellite, num_envs=16, world_args={"utc_init": EPOCH}, backend="eager", seed=3)
    env.reset()
    starts = env.simulator.arcs.flown[:, LEAD_NODES]
    expected = torch.from_numpy(skyfield_positions(FLEET, float(env.simulator.arcs.et[0])))
    near = torch.cdist(starts, expected).min(1)
    assert float(near.values.max()) < 1.0
    assert set(near.indices.tolist()) == {0, 1, 2}


def test_the_earth_turns_as_itrf_under_real_orbits():
    env, other = team(GREENSAT), team(GREENSAT, world_args={"utc_init": EPOCH, "earthRotation": "IAU_EARTH"})
    for each in (env, other):
        each.reset()
    PN, plain = (each.fleet.simulators[0].world.PN[0] for each in (env, other))
    assert 9e3 < float((PN - plain).norm()) * 6.378e6 / 2**0.5 < 1e4
    old = SatelliteTasking(Drifter("A"), num_envs=1, backend="eager", seed=0)
    assert old.simulator.type.arguments.world_args.given["earthRotation"] == "IAU_EARTH"


NAMES = ["GREENSAT-1 (A)", "HAWK 2 [x/y]", "a.b: <c> \"d\" 'e' & %s {f}", "Züri ★"]


def test_names_of_catalogs_work_everywhere(tmp_path):
    sets = read_orbits(FLEET)
    satellites = [Drifter(name, {"oe": orbit}) for name, orbit in zip(NAMES, [*sets, sets[0]], strict=True)]
    env = team(satellites, log_dir=tmp_path / "log.txt", log_level="INFO")
    td = env.rollout(2)
    assert list(env.group_map.values()) == [NAMES]
    assert td["next", "reward"].shape[0] == 2 if ("next", "reward") in td.keys(True) else True
    state = env.get_state()
    env.rollout(1)
    env.restore(state)
    text = (tmp_path / "log.txt").read_text()
    assert all(name in text for name in NAMES)


def test_pettingzoo_and_recordings_take_names_of_catalogs():
    from bsk_torch.recording import record
    from bsk_torch.wrappers.pettingzoo import parallel_env

    env = team(GREENSAT, num_envs=1)
    policy = TensorDictModule(
        lambda mask: torch.zeros(mask.shape[:2], dtype=torch.int64), [("agents", "action_mask")], [("agents", "action")]
    )
    recording = record(env, policy, until=10.0)
    assert [craft.name for craft in recording.satellites] == ["GREENSAT-1 (A)"]
    zoo = parallel_env(team(GREENSAT, num_envs=1))
    assert zoo.possible_agents == ["GREENSAT-1 (A)"]


def test_arguments_names_and_formats(tmp_path):
    (tmp_path / "gp.json").write_text(OMM_JSON)
    chosen = Drifter.from_orbits(FLEET, {"mass": 50.0}, names=["HAWK 2 [x/y]"], max_age_days=3.0)
    assert [each.name for each in chosen] == ["HAWK 2 [x/y]"]
    assert (chosen[0].sat_args_generator["mass"], chosen[0].sat_args_generator["oe"].max_age_days) == (50.0, 3.0)
    assert Drifter.from_orbits(tmp_path / "gp.json")[0].name == "GREENSAT-1 (A)"
    drawn = Drifter.from_tle(GREENSAT, lambda: {"mass": 60.0})
    env = team(drawn, num_envs=1)
    env.reset()
    assert float(env.fleet.simulators[0].argument("mass")[0]) == 60.0
    (single,) = Drifter.from_orbits(OPM)
    env = team([single], "2026-04-13T22:18:17.006Z", num_envs=1)
    env.reset()
    r = env.fleet.simulators[0].arcs.flown[0, LEAD_NODES]
    torch.testing.assert_close(r, torch.tensor([1580996.0, 84049.0, 6951379.0], dtype=torch.float64), rtol=0, atol=1e-3)


class Mover(Drifter):
    fsw_type = fsw.MagicOrbitalManeuverFSWModel


def test_wrong_uses_are_refused():
    (orbit,) = read_orbits(GREENSAT)
    check_refusals(
        refusal(
            lambda: team(GREENSAT, "2021-01-01T00:00:00Z"), ValueError, "GREENSAT-1 (A)", "days", "2026-04-13", "max_age_days"
        ),
        refusal(lambda: Drifter.from_tle(GREENSAT, {"oe": [7e6, 0, 0, 0, 0, 0]}), ValueError, "sat_args", "oe"),
        refusal(lambda: Drifter.from_tle(FLEET, names=["HAWK 3"]), ValueError, "names='HAWK 3'", "HAWK 2 [x/y]"),
        refusal(lambda: Drifter.from_tle(OMM_JSON), ValueError, "line"),
        refusal(lambda: team([Drifter("A", {"oe": orbit, "mu": 4e14})]), ValueError, "mu", "oe"),
        refusal(lambda: team([Drifter("A")], orbit="sgp4"), ValueError, "orbit='sgp4'", "oe", "from_tle"),
        refusal(lambda: team(Mover.from_tle(GREENSAT), orbit="sgp4"), ValueError, "orbit='sgp4'", "maneuvers"),
    )
