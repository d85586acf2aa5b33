"""Windows beyond what has been generated, and what satellites know of the rewarder."""

import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, data, obs, sats, scene
from bsk_torch.presets.aeos import agile_args
from tests.support.episodes import begun
from tests.support.refusals import check_refusals, refusal

LIMIT, BINS, WIDTH = 600.0, 20, 180.0


class Density(obs.Observation):
    """Sum of the priorities of targets whose next window closes in each of 20 bins of 180 s, divided by 5."""

    def __init__(self):
        super().__init__("density")

    def get_obs(self):
        satellite, now = self.satellite, self.simulator.sim_time.unsqueeze(-1)
        close = satellite.next_opportunities("target", until=now.squeeze(-1) + (BINS + 1) * WIDTH)[1]
        number = torch.floor((close - now) / WIDTH).clamp(max=BINS).long()  # infinity, too, goes into the last one, left out
        priority = self.simulator.of_env(satellite.scenario.priority)
        return torch.zeros(len(now), BINS + 1).double().scatter_add(1, number, priority)[:, :BINS] / 5.0


class Imager(sats.ImagingSatellite):
    observation_spec = (obs.Time(norm=1.0),)
    action_spec = (act.Charge(duration=60.0), act.Image(n_ahead_image=2))


class Dense(Imager):
    observation_spec = (Density(),)


def args():
    return {name: value for name, value in agile_args().items() if name not in ("omega_max", "servo_P")}


def make(cls=Imager, time_limit=LIMIT, **options):
    fixed = dict(num_envs=2, seed=3, backend="eager", dtype=torch.float64, rewarder=data.UniqueImageReward())
    return SatelliteTasking(cls("EO", args()), scene.UniformTargets(300), time_limit=time_limit, **(fixed | options))


def test_windows_beyond_the_time_limit():
    """They are those that an environment with a longer limit has generated at reset."""
    short, long = make(), make(time_limit=6000.0)
    for env in (short, long):
        env.reset()
    few, until = short.satellite.upcoming_opportunities("target"), torch.tensor([3000.0, 4100.0]).double()
    found = short.satellite.find_windows(until)
    expected = long.satellite.find_windows(until)
    there = torch.isfinite(found.close)
    assert torch.isfinite(few.close).sum() < there.sum()
    assert (found.open[there] < until.unsqueeze(-1).expand_as(found.open)[there]).all()
    assert (found.close.diff(dim=1)[there[:, 1:]] >= 0.0).all()  # sorted, the missing ones last
    for row in range(2):
        whole = found.close[row] < 0.99 * until[row]  # windows in progress at the end of look-ahead are cut there
        count = int(whole.sum())
        assert count > 10
        assert torch.allclose(found.close[row, :count], expected.close[row, :count], atol=1e-6)
        assert torch.equal(found.place[row, :count], expected.place[row, :count])


def test_rows_extend_their_own_look_ahead_only():
    env = begun(make())
    access = env.simulator.access
    before = access.until.clone()
    env.satellite.find_windows(torch.tensor([100.0, 2500.0]).double())
    assert access.until.tolist() == [float(before[0]), 3000.0]


def test_a_query_does_not_see_what_the_last_of_its_hundred_segments_adds():
    """As in bsk_rl, where the search comes before each of a hundred extensions; the next query sees it."""
    known = begun(make(num_envs=1, time_limit=12000.0))
    opens = known.satellite.upcoming_opportunities("target").open[0].sort().values
    opens = opens[torch.isfinite(opens)]
    count = int((opens < 7000.0).sum())
    first = 60.0 * (opens[count] // 60.0).item() - 99.0 * 60.0  # so that window ``count`` opens in segment 100
    seen = int((opens < first + 99.0 * 60.0).sum())
    satellite = Imager("EO", args(), generation_duration=60.0, initial_generation_duration=first)
    env = SatelliteTasking(satellite, scene.UniformTargets(300), data.UniqueImageReward(), num_envs=1, seed=3, backend="eager")
    env.reset()
    assert env.satellite.find_next_opportunities(seen + 1).found.item() == seen
    assert env.satellite.find_next_opportunities(seen + 2).found.item() > seen


def test_density_of_targets():
    env = make(Dense)
    td = env.reset()
    windows = env.satellite.opportunities_dict(1)
    expected = torch.zeros(BINS).double()
    for place, times in windows.items():
        if times[0][1] < BINS * WIDTH:
            expected[int(times[0][1] // WIDTH)] += env.scenario.priority[1, place] / 5.0
    assert torch.allclose(td["observation"][1], expected)
    assert expected[-5:].sum() > 0.0  # far beyond the time limit


def test_rejects_wrong_times_and_rewarders_without_a_store():
    env, without = make(), make(rewarder=data.NoReward())
    env.reset()
    check_refusals(
        *(
            refusal(lambda until=until: env.satellite.find_windows(until), ValueError, "until", until, "[2]")
            for until in (torch.zeros(3), float("inf"), torch.tensor([1.0, float("nan")]))
        ),
        refusal(lambda: env.satellite.find_windows(100.0, "targets"), ValueError, "type", "'targets'", "'target'"),
        refusal(lambda: without.satellite.data_store, AttributeError, "NoReward", "data.UniqueImageReward"),
    )


def pair():
    satellites = [Imager(name, args()) for name in ("A", "B")]
    fixed = dict(num_envs=2, seed=3, backend="eager", time_limit=60.0)
    return ConstellationTasking(satellites, scene.UniformTargets(30), data.UniqueImageReward(), **fixed)


def test_satellites_ask_the_rewarder():
    env = begun(pair())
    nobody = torch.zeros(2, 2, dtype=torch.bool)
    env.rewarder.value(torch.tensor([[5, 0], [7, 7]]), nobody.index_fill(1, torch.tensor([0]), True))
    satellite, known = env.satellites[0], torch.zeros(2, 2, 30, dtype=torch.bool)
    known[0, 0, 5] = known[1, 0, 7] = True
    assert satellite.rewarder is env.rewarder
    assert torch.equal(satellite.known_images, known.flatten(0, 1))
    assert torch.equal(satellite.data_store.data.imaged, satellite.known_images)
    env.rewarder.share(torch.ones(2, 2, 2, dtype=torch.bool))
    assert satellite.known_images.view(2, 2, 30)[1, 1, 7]
    assert torch.equal(env.rewarder.data.imaged, known[:, 0])
    assert env.rewarder.data.known.all()


def test_data_of_one_environment_are_sets_of_targets():
    env = begun(pair())
    env.rewarder.value(torch.tensor([[5, 6], [7, 7]]), torch.tensor([[True, True], [True, False]]))
    one, other = (env.rewarder.data_of(row) for row in range(2))
    assert one.imaged == {env.scenario.target_object(0, 5), env.scenario.target_object(0, 6)}
    assert (len(other.imaged), len(one.known)) == (1, 30)
