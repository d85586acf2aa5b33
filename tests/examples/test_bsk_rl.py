"""Examples of bsk_rl's documentation: ours from the same start, with the same actions, give what bsk_rl's gave.

Rewards, durations, names and flags are exact, observations to the bounds of the replays in tests/basilisk.
"""

import re
import sys

import pytest
import torch

from bsk_torch import data, obs
from bsk_torch.tasks.inspection import RSOInspectionReward, SphericalRSO
from bsk_torch.tasks.objects import RSOTargetCatalog
from tests.basilisk import test_manoeuvres as manoeuvres
from tests.examples.recorded import BY_NAME, FOLDER, Replay, example, load, start
from tests.examples.scenarios import areas, beliefs, clouds, find_after
from tests.tasks.inspection import replay as inspections

pytestmark = pytest.mark.compiled


@pytest.fixture(autouse=True)
def eclipses_as_recorded(monkeypatch):
    """The examples observe true eclipses, the recordings bsk_rl's, which are on a grid of 30 s."""
    init = obs.Eclipse.__init__
    monkeypatch.setattr(obs.Eclipse, "__init__", lambda self, norm=1.0, sampled=True: init(self, norm, sampled=True))


STEERING = 1e-5
"""Bound of observations with the steering law, whose loop amplifies rounding; 1e-6 without."""


@pytest.mark.parametrize("name", ["simple_environment", "rllib_training", "time_discounted_gae", "async_multiagent_training"])
def test_scanning(name):
    """Without targets: the first page, and those that train in nadir scanning."""
    recorded = load(name)
    Replay(example(name).make(**start(recorded)), recorded).run()


@pytest.mark.parametrize("part", ["properties", "bespoke", "custom", "opportunities", "composed", "actions", "images"])
def test_satellite_configuration(part):
    recorded = load(f"configuration_{part}")
    targets = dict(scenario=recorded.targets) if len(recorded.arrays["targets"]) else {}
    env = example("satellite_configuration").make(part, **(start(recorded) | targets))

    def look_ahead(env, k):
        if part == "images":  # the page names the last of the next ten targets
            assert env.satellite.find_next_opportunities(10).place[0, 9] == recorded.arrays["action"][0, 0] - BY_NAME

    Replay(env, recorded, before=look_ahead).run()


@pytest.mark.parametrize("joint", [True, False])
def test_multiagent_envs(joint):
    """One satellite is killed in the sixth step, and sees once more where it is a separate agent."""
    recorded, module = load("multiagent_general" if joint else "multiagent_constellation"), example("multiagent_envs")
    env = module.make(joint=joint, **(start(recorded) | dict(scenario=recorded.targets)))
    Replay(env, recorded, tolerance=STEERING, before=lambda env, k: module.kill(env, 0) if k == 6 else None).run()
    assert env.dead[0].tolist() == [True, False, False]


def test_communication_action():
    recorded = load("communication_action")
    env = example("communication_action").make(**(start(recorded) | dict(scenario=recorded.targets)))
    Replay(env, recorded, tolerance=STEERING).run()


@pytest.mark.parametrize("variant", ["S1", "S2", "S3", "power"])
def test_aeos(variant):
    recorded = load(f"aeos_{variant}")
    env = example("aeos").make(variant, **(start(recorded) | dict(scenario=recorded.targets)))
    Replay(env, recorded, tolerance=STEERING).run()
    assert recorded.arrays["reward"].sum() > 1.0  # otherwise exact rewards would say little


def test_cloud_environment():
    recorded, module = load("cloud_environment"), example("cloud_environment")
    env = module.make(**(start(recorded) | dict(scenario=clouds(module, recorded))))
    Replay(env, recorded, tolerance=STEERING).run()
    assert (env.counts()["cloud_free"] > 1).all()
    assert (env.counts()["cloud_covered"] > 1).all()


def test_cloud_environment_with_reimaging():
    recorded, module = load("cloud_environment_with_reimaging"), example("cloud_environment_with_reimaging")
    env = module.make(**(start(recorded) | dict(scenario=beliefs(module, recorded))))
    Replay(env, recorded, tolerance=STEERING).run()
    assert env.counts()["reimaged"].sum() > 0


def test_beliefs_at_the_threshold():
    """An image that completes a target pays once; satellites that image it together update its belief one after the other."""
    module = example("cloud_environment_with_reimaging")
    seconds = torch.tensor([-1.0, 0.0, 1.0, 900.0, 1e9])
    changed = module.time_variation(seconds)
    assert changed[:2].tolist() == [0.0, 0.0]
    assert changed[2:].tolist() == pytest.approx([1 / (1 + torch.exp(torch.tensor(-2.5 * (1 / 360 - 2.5)))).item(), 0.5, 1.0])


def test_target_location_uncertainty():
    recorded, module = load("target_location_uncertainty"), example("target_location_uncertainty")
    env = module.make(**(start(recorded) | dict(scenario=areas(module, recorded))))
    Replay(env, recorded, tolerance=STEERING, before=lambda env, k: find_after(env, recorded, k)).run()
    assert int(env.counts()["found_again"]) > 1


def test_curriculum_learning():
    """Three difficulties in one batch; the battery of each follows from it."""
    recorded = [load(f"curriculum_learning_{level}") for level in (0, 50, 100)]
    options = start(*recorded)
    batteries = [one.setup["sat_args"][0]["batteryStorageCapacity"] for one in recorded]
    del options["sat_args"]["batteryStorageCapacity"]
    env = example("curriculum_learning").make(difficulty=[0.0, 0.5, 1.0], **options)
    Replay(env, *recorded).run()
    assert env.satellite.sat_args["batteryStorageCapacity"].tolist() == pytest.approx(batteries)


def test_the_curriculum_draws_what_the_page_draws():
    module = example("curriculum_learning")
    env = module.make(num_envs=64, difficulty=1.0, backend="eager", seed=0)
    env.reset()
    arguments = env.satellite.sat_args
    torque = torch.tensor([one["disturbance_vector"] for one in load("curriculum_learning_100").setup["sat_args"]]).norm()
    torch.testing.assert_close(arguments["disturbance_vector"].norm(dim=1), torque.double().expand(64))
    share = arguments["storedCharge_Init"] / arguments["batteryStorageCapacity"]
    low, high = module.INITIAL_CHARGE
    assert low <= float(share.min()) < float(share.max()) <= high


def test_training_with_shield():
    """The rule replaced actions where the recording says; the mask allows those that were taken."""
    recorded, module = load("training_with_shield"), example("training_with_shield")
    env = module.make(masked=True, **(start(recorded) | dict(scenario=recorded.targets)))
    narrow = []

    def legal(env, k):
        mask = module.allowed(env.satellite)
        assert mask.gather(1, torch.from_numpy(recorded.arrays["action"][k]).unsqueeze(1)).all()
        narrow.append(int(mask.sum()) == 1)

    Replay(env, recorded, tolerance=STEERING, before=legal).run()
    assert any(narrow)
    assert not all(narrow)


def test_rso_inspection():
    """Points, rewards and observations of an inspector with the steering law, with the page's actions of real numbers."""
    recorded, module = inspections.load("steer"), example("rso_inspection")
    first = recorded.initial[0]
    env = module.make(
        len(recorded),
        sat_args=[inspections.arguments(recorded.initial, k) for k in range(2)],
        scenario=SphericalRSO(**first["scenario"]),
        rewarder=(
            RSOInspectionReward(**first["reward"]),
            data.ResourceReward(reward_weight=first["fuel_weight"], resource_fn=module.fuel),
        ),
        world_args=dict(utc_init=first["utc_init"]),
        time_limit=first["time_limit"],
        sim_rate=first["sim_rate"],
        dtype=torch.float64,
        compat="bsk_rl",
        seed=0,
    )
    renamed = {"rso_imaged_regions": "fifteen_hill", "reward_weight": "reward_weight[0]"}
    names = " ".join(env.satellites[1].observation_description)
    for mine, theirs in renamed.items():
        names = names.replace(mine, theirs)
    columns = [recorded.names.index(name) for name in names.split()]
    for k, moves, outputs in inspections.replay(env, recorded):
        assert moves.all()
        rso, inspector = (outputs[group.name] for group in env.groups)
        reward = torch.cat([rso["reward"], inspector["reward"]], 1).squeeze(-1)
        torch.testing.assert_close(reward, inspections.padded(recorded, "reward", k), rtol=0, atol=1e-12)
        wanted = inspections.padded(recorded, "obs", k + 1)[..., columns]
        torch.testing.assert_close(inspector["observation"], wanted, rtol=0, atol=1e-6)
        for what in ("inspected", "illuminated"):
            assert torch.equal(getattr(env.rewarder, what), inspections.padded(recorded, what, k + 1)[:, 0] > 0.5)
    assert env.rewarder.inspected.sum() >= 3


def test_continuous_orbit_maneuvers():
    """Orbits after manoeuvres of single precision; passes and eclipses are those of the first orbit, as in bsk_rl."""
    module = example("continuous_orbit_maneuvers")

    def make(kind, args, **options):
        return module.make(sat_args=args, **options)

    found = manoeuvres.replay("manoeuvre_scan", make=make, orbit="integrated", compat="bsk_rl")
    assert all(difference <= manoeuvres.INTEGRATED[quantity] for quantity, difference in found.items()), found


@pytest.mark.parametrize("profile", ["compact", "amos"])
def test_space_to_space_rso_imaging(profile):
    """The imager; its targets, satellites in bsk_rl, do nothing. All three are imaged and delivered, and some again."""
    recorded = load(f"space_to_space_rso_imaging_{profile}").only("imager")
    catalog = RSOTargetCatalog.from_dict(recorded.setup["catalog"])
    options = start(recorded) | dict(time_limit=recorded.setup["time_limit"], mask_busy=False)
    env = example("space_to_space_rso_imaging").make(profile, **(options | dict(catalog=catalog)))
    Replay(env, recorded).run()
    counts = {name: int(number) for name, number in env.rewarder.counts().items()}
    assert counts == (dict(captured=6, delivered=3) if profile == "compact" else dict(captured=9, delivered=6))


def test_rules_of_space_to_space_rso_imaging():
    """They image only what is in sight and lit, and the rule by priority the most important."""
    env = example("space_to_space_rso_imaging").make(num_envs=8, time_limit=3000.0, seed=0)
    module, images = example("space_to_space_rso_imaging"), 0
    td = env.reset()
    for _ in range(12):
        imager = env.satellites[0]
        candidates = env.scenario.candidates(imager, 3)
        seen = env.scenario.in_sight(imager, candidates)
        seen &= env.scenario.views(imager, candidates).target_illumination_factor >= 0.5
        for rule in ("priority", "nearest", "random"):
            action = module.choose(env, rule)
            slot = (action - module.IMAGE).clamp(min=0)
            chosen = action >= module.IMAGE
            assert bool(td["agents", "action_mask"].squeeze(1).gather(1, action).all())
            assert not bool((chosen & ~seen.gather(1, slot)).any())
        action = module.choose(env, "priority")
        taken = env.scenario.priority.gather(1, candidates.place)
        best = torch.where(seen, taken, -1.0).amax(1)
        rows = (action >= module.IMAGE).squeeze(1)
        assert torch.equal(taken.gather(1, (action - module.IMAGE).clamp(min=0)).squeeze(1)[rows], best[rows])
        images += int(rows.sum())
        td = env.step(td.set(("agents", "action"), action))["next"]
    assert images > 20


FAULTY = {"fault_environment": False, "fault_environment_literal": True, "fault_environment_literal_charge": True}
"""Recorded episodes, and whether they are those of the page, without corrections."""


@pytest.mark.parametrize("name", FAULTY)
def test_fault_environment(name):
    recorded, module = load(name), example("fault_environment")
    env = module.make(literal=FAULTY[name], **(start(recorded) | dict(scenario=recorded.targets)))
    Replay(env, recorded, tolerance=STEERING).run()
    assert bool(recorded.arrays["terminated"][-1]) == FAULTY[name]
    assert (recorded.arrays["reward"].sum() == 0.0) == ("charge" in name)  # images of no target have filled the store


SMALL = "--num-envs 2 --time-limit 300"
TRAINING = f"{SMALL} --iterations 2 --rollout 4"

STARTS = {
    "simple_environment": (SMALL, "truncated|charge"),
    "satellite_configuration": ("--num-envs 2", "reward for target"),
    "multiagent_envs": ("--num-envs 2", r"alive tensor\(\[\[False"),
    "communication_action": ("--num-envs 2", "heard"),
    "aeos": (f"power {SMALL}", "rewards"),
    "cloud_environment": (SMALL, "cloud_free"),
    "cloud_environment_with_reimaging": (f"{SMALL} --steps 3", "complete"),
    "rllib_training": (TRAINING, "rewards of the first"),
    "time_discounted_gae": (TRAINING, "entropy"),
    "async_multiagent_training": (TRAINING, "deciding"),
    "target_location_uncertainty": (f"{SMALL} --n-targets 300", "found_again"),
    "curriculum_learning": (TRAINING, "torque"),
    "mixed_environment": (SMALL, r"ground_images: \["),
    "rso_inspection": (SMALL, "of lit"),
    "space_to_space_rso_imaging": (f"{SMALL} --policy nearest", r"captured: \["),
    "continuous_orbit_maneuvers": (SMALL, "semi-major axis"),
    "fault_environment": (f"{SMALL} --literal", "faults: tensor"),
    "training_with_shield": (f"{TRAINING} --n-targets 300 --shield replacement", "replaced actions"),
}
"""Arguments of the smallest run of each file, and what it prints."""


@pytest.mark.parametrize("name", STARTS)
def test_runs(name, tmp_path, monkeypatch, capsys):
    arguments, printed = STARTS[name]
    module = example(name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *arguments.split(), "--figure", "picture.png"])
    module.main()
    assert re.search(printed, capsys.readouterr().out)
    assert (tmp_path / "picture.png").read_bytes()[:4] == b"\x89PNG"


def test_a_report_is_drawn_over_the_frames_whatever_its_columns_are_called(tmp_path, monkeypatch):
    from bsk_torch.viz.figures import style

    show, drawn = example("rllib_training").Show(), []
    monkeypatch.setattr(style, "save", lambda figure, path: drawn.append(figure))
    for frames, share in ((100, 0.5), (200, 0.25)):
        show(frames, {"decisions": share})
    show.draw(tmp_path / "curve.png", "decisions")
    (line,) = drawn[0].axes[0].lines
    assert (list(line.get_xdata()), list(line.get_ydata())) == ([100, 200], [0.5, 0.25])


def test_every_file_is_started_and_listed():
    files = {path.stem for path in FOLDER.glob("*.py")}
    assert files == set(STARTS)
    table = (FOLDER / "README.md").read_text()
    assert all(f"`{name}.py`" in table for name in files)


@pytest.mark.parametrize("name", STARTS)
def test_lines_that_differ_are_marked(name):
    assert (FOLDER / f"{name}.py").read_text().count("# bsk_rl") >= 2
