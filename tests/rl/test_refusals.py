"""Wrong settings, policies, rules and evaluations: what each must raise, and what its message must name."""

import dataclasses

import pytest
import torch
from tensordict.nn import TensorDictModule

import bsk_torch
from bsk_torch import dyn
from bsk_torch.act import allow_only
from bsk_torch.lab.audit.charge_bound import most_power
from bsk_torch.lab.suites.aggregates import bootstrap
from bsk_torch.lab.suites.suite import EPISODES, play, tasks_of
from bsk_torch.rl.evaluation.evaluate import evaluate, start_episodes
from bsk_torch.rl.marl import MAPPOConfig
from bsk_torch.rl.marl.mappo import MAPPOLearner
from bsk_torch.rl.marl.runs import read_config
from bsk_torch.rl.networks.plans import AttentionPlan, GRUPlan, MLPPlan
from bsk_torch.rl.policies import check_fits, pretrained, pretrained_file, read_card
from bsk_torch.rl.policies.shared_policy import GroupPolicies, member_view, member_views, shared
from bsk_torch.rl.rules.baselines import Columns, random_policy
from bsk_torch.rl.rules.shield import shield
from bsk_torch.rl.training.config import PPOConfig, override
from bsk_torch.rl.training.imitation import find_teacher
from bsk_torch.rl.training.log import LOG, read_log
from bsk_torch.rl.training.trainer import check_folder
from tests.support.refusals import check_refusals, refusal

CREW = {"n_imagers": 2, "n_relays": 1, "n_targets": 200, "time_limit": 600.0}


@pytest.fixture(scope="module")
def scanning():
    return bsk_torch.make("NadirScan-v1", num_envs=2, seed=0, backend="eager", time_limit=400.0)


@pytest.fixture(scope="module")
def imaging():
    return bsk_torch.make("AEOS-v1", num_envs=1, n_targets=20, n_ahead=24, as_set=True, time_limit=300.0, backend="eager")


def always(action):
    return TensorDictModule(lambda mask: torch.full(mask.shape[:-1], action), in_keys=["action_mask"], out_keys=["action"])


def test_rejects_wrong_values_and_changes_of_settings():
    change = lambda text: override(PPOConfig(), [text])
    check_refusals(
        refusal(lambda: change("learning_rat=1"), ValueError, "'learning_rat'", "'learning_rate'"),
        refusal(lambda: change("learning_rate"), ValueError, "'learning_rate'", "name=value"),
        refusal(lambda: change("frames=many"), ValueError, "frames", "'many'", "Integer"),
        refusal(lambda: change("hidden=[wide]"), ValueError, "hidden", "'wide'", "Integer"),
        refusal(lambda: change("gamma=1.5"), ValueError, "gamma", 1.5, "(0, 1]"),
        refusal(lambda: change("network=mpl"), ValueError, "network", "'mpl'", "'mlp'"),
        refusal(lambda: change("reward_time=ende"), ValueError, "reward_time", "'ende'", "'end'"),
        refusal(lambda: change("entropy_schedule=lienar"), ValueError, "entropy_schedule", "'lienar'", "'linear'"),
        refusal(lambda: change("loggers=[cvs]"), ValueError, "loggers", "'cvs'", "'csv'"),
        refusal(lambda: change("collector=mutli"), ValueError, "collector", "'mutli'", "'multi'"),
        refusal(lambda: change("workers=0"), ValueError, "workers", 0, 1),
        refusal(lambda: change("workers=atuo"), ValueError, "workers", "'atuo'", "'auto'"),
        refusal(lambda: change("epochs=0"), ValueError, "epochs", 0, 1),
        refusal(lambda: change("checkpoint_every=-1"), ValueError, "checkpoint_every", -1),
        refusal(lambda: change("patience=0"), ValueError, "patience", 0, 1),
        refusal(lambda: change("frames=0"), ValueError, "frames", 0, 1),
        refusal(lambda: change("seconds=0"), ValueError, "seconds", 0.0, "(0, inf)"),
        refusal(lambda: change("seconds=nan"), ValueError, "seconds", "nan", "(0, inf)"),
        refusal(lambda: change("seconds=inf"), ValueError, "seconds=inf", "(0, inf)"),
        refusal(lambda: change("clip=-1"), ValueError, "clip", -1.0, "(0, 1]"),
        refusal(lambda: change("clip=nan"), ValueError, "clip", "nan", "(0, 1]"),
        refusal(lambda: change("lmbda=2"), ValueError, "lmbda", 2.0, "[0, 1]"),
        refusal(lambda: change("gamma=nan"), ValueError, "gamma", "nan", "(0, 1]"),
        refusal(lambda: change("learning_rate=-1"), ValueError, "learning_rate", -1.0, "[0, 1]"),
        refusal(lambda: change("learning_rate=inf"), ValueError, "learning_rate", "inf", "[0, 1]"),
        refusal(lambda: change("entropy=-0.1"), ValueError, "entropy", -0.1, "[0, inf)"),
        refusal(lambda: change("gradient_norm=0"), ValueError, "gradient_norm", 0.0, "(0, inf)"),
        refusal(lambda: change("gradient_norm=nan"), ValueError, "gradient_norm", "nan", "(0, inf)"),
        refusal(lambda: change("hidden=[0]"), ValueError, "hidden", 0, 1),
        refusal(lambda: change("hidden=[64,-1]"), ValueError, "hidden", -1),
        refusal(lambda: change("hidden=[1000000000]"), ValueError, "hidden", 10**9, 65536),
        refusal(lambda: change("hidden=[1"), ValueError, "hidden", "[1", "sequence"),
        refusal(lambda: change("hidden=5"), ValueError, "hidden", 5),
        refusal(lambda: change("seed=-1"), ValueError, "seed", -1),
        refusal(lambda: change("seed=9223372036854775808"), ValueError, "seed", 2**63, 2**62),
        refusal(lambda: change("num_envs=0"), ValueError, "num_envs", 0, 1),
        refusal(lambda: change("minibatch=0"), ValueError, "minibatch", 0, 1),
        refusal(lambda: change("options=5"), ValueError, "options", 5),
        refusal(lambda: change("options.num_envs=5"), ValueError, "options.num_envs", "setting 'num_envs'"),
        refusal(lambda: change("options.seed=5"), ValueError, "options.seed", "setting 'seed'"),
        refusal(lambda: change("options.env_ids=[0]"), ValueError, "options.env_ids", "setting 'num_envs'"),
        refusal(lambda: change("=1"), ValueError, "setting ''", "num_envs"),
    )
    # Also where no command line has brought the values into their types.
    may_be_none = ("seconds", "frames", "patience", "imitate", "evaluate_every")
    names = [field.name for field in dataclasses.fields(PPOConfig) if field.name not in ("preset", "options")]
    wrong = [(name, value) for name in names for value in (float("nan"), -1, "wide", (0.5,), object())]
    wrong += [(name, None) for name in names if name not in may_be_none]
    check_refusals(
        refusal(lambda name=name, value=value: PPOConfig(**{name: value}), ValueError, name, str(value).strip("(,)"))
        for name, value in wrong
    )


def test_rejects_settings_that_do_not_work(tmp_path):
    worth = ("imitation_temperature", 0.1, ["greedy", "hasty", "farsighted", "cooperative"])
    shared_out = lambda collector, workers: PPOConfig(collector=collector, workers=workers, num_envs=16)
    imitate = lambda rule="hasty", **changes: PPOConfig(imitate=rule, **changes)
    (tmp_path / "config.yaml").write_bytes(b"preset: \xff\xfe")
    check_refusals(
        refusal(lambda: read_config(tmp_path), ValueError, "config.yaml", "configuration"),
        refusal(lambda: PPOConfig(network="atention"), ValueError, "network", "'atention'", "'attention'"),
        refusal(lambda: PPOConfig(seconds=0.0), ValueError, "seconds", 0.0, "(0, inf)"),
        refusal(lambda: PPOConfig(frames=-1), ValueError, "frames", -1),
        refusal(lambda: shared_out("multi", 3), ValueError, "workers=3", "num_envs=16", "workers=2"),
        refusal(lambda: shared_out("ray", 32), ValueError, "workers=32", "num_envs=16", "workers=16"),
        refusal(lambda: PPOConfig(ahead=True), ValueError, "ahead=True", "collector", "'multi'", "'ray'"),
        refusal(lambda: PPOConfig(precision="bfloat8"), ValueError, "precision", "'bfloat8'", "'bfloat16'"),
        refusal(lambda: imitate("hasy"), ValueError, "imitate", "'hasy'", "'hasty'"),
        refusal(lambda: imitate("random"), ValueError, "imitate", "'random'", "'greedy'"),
        refusal(lambda: imitate(imitation=0.0), ValueError, "imitation", 0.0, "(0, 1]"),
        refusal(lambda: imitate(imitation=float("nan")), ValueError, "imitation", "nan", "(0, 1]"),
        refusal(lambda: imitate(imitation_temperature=-0.1), ValueError, "imitation_temperature", -0.1, "[0, inf)"),
        refusal(lambda: imitate("survey", imitation_temperature=0.1), ValueError, *worth, "imitate='survey'"),
        refusal(lambda: imitate("nearest", imitation_temperature=0.1), ValueError, *worth, "imitate='nearest'"),
        refusal(lambda: MAPPOConfig(algorithm="mapo"), ValueError, "algorithm", "'mapo'", "'mappo'"),
        refusal(lambda: MAPPOConfig(network="mlp"), ValueError, "network", "'mlp'", "'attention'"),
        refusal(lambda: GRUPlan(12, 4, (64,)), ValueError, "hidden", (64,), (64, 64)),
    )


def test_rejects_wrong_folders_and_logs(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    (tmp_path / LOG).write_text("a,b\n1,2\n")
    names = ("file", "file/run", "link")
    check_refusals(
        *(refusal(lambda name=name: check_folder(tmp_path / name), OSError, tmp_path / name, "folder") for name in names),
        refusal(lambda: read_log(tmp_path / LOG), ValueError, "log.csv", "training", "'frames'", "'seconds'"),
    )


def test_rejects_networks_and_policies_that_do_not_fit(scanning, imaging):
    card = read_card(pretrained_file("AEOS-v1"))
    crafted = lambda **plan: check_fits(card | {"plan": card["plan"] | plan}, imaging)
    blocks = lambda hidden: AttentionPlan(("observation", "target"), (), 3, 4, 5, (0, 5), hidden)
    crafted()
    check_refusals(
        refusal(lambda: crafted(images=5), ValueError, "AEOS-v1", "images=5", "images=(0, 24)"),
        refusal(lambda: crafted(images=(3, 35)), ValueError, "AEOS-v1", "images=(3, 35)", "images=(0, 32)"),
        refusal(lambda: crafted(n_actions=33), ValueError, "AEOS-v1", "n_actions=33", "n_actions=32"),
        refusal(lambda: crafted(images=(0, 33)), ValueError, "AEOS-v1", "n_actions=32", "n_actions=33"),
        refusal(lambda: crafted(images=("a", "b")), ValueError, "AEOS-v1", "images=('a', 'b')", "images=(0, 24)"),
        refusal(lambda: crafted(images=()), ValueError, "AEOS-v1", "images=()", "images=(0, 24)"),
        refusal(lambda: AttentionPlan.of(scanning, (32,)), ValueError, "network", "'attention'", "as_set=True"),
        refusal(lambda: MLPPlan.of(imaging, (32,)), ValueError, "'mlp'", "vector", "obs_type=torch.Tensor"),
        *(refusal(lambda h=h: blocks(h), ValueError, f"hidden={h}", "multiples of 32") for h in ((), (48,), (32, 64))),
    )
    crew = lambda **options: bsk_torch.make("RelayConstellation-v1", num_envs=1, backend="eager", **CREW, **options)
    pair = {"pair": ["EO1", "EO2"]}
    sets, vectors, flying = crew(as_set=True), crew(), bsk_torch.make("RSOInspection-v1", num_envs=1, backend="eager")
    inspector = next(view for name, view in member_views(flying).items() if "inspector" in name)
    config = MAPPOConfig("RSOInspection-v1", imitate="hasty", options={"backend": "eager"}, num_envs=1, frames=8)
    imaging_and_relay, groups = "broadcasting_imager, relay", GroupPolicies({"a": always(0), "b": always(0)})
    check_refusals(
        refusal(lambda: pretrained("NadirScan-v2"), ValueError, "'NadirScan-v2'", "'NadirScan-v1'"),
        refusal(lambda: member_view(vectors), ValueError, "alike", imaging_and_relay),
        refusal(lambda: shared(always(0), vectors), ValueError, "alike", imaging_and_relay),
        refusal(lambda: shared(groups, sets), ValueError, "a, b", "broadcasting_set_imager, relay"),
        refusal(lambda: bsk_torch.rule("rule", sets), KeyError, "'storage_level_fraction'"),
        refusal(lambda: member_views(crew(joint=True)), ValueError, "separate agent", "agents"),
        refusal(lambda: member_views(crew(meta_agent_groupings=pair)), ValueError, "separate agent", "pair"),
        refusal(lambda: find_teacher("survey", inspector), ValueError, "imitate='survey'", "real numbers"),
        refusal(lambda: MAPPOLearner(config, flying), ValueError, "imitate='hasty'", "RSOInspection-v1", "imitate=null"),
    )


def test_rejects_rules_that_do_not_fit(scanning):
    columns, listed = Columns(torch.zeros(1, 1), ["storage_level_fraction"]), {"action_charge": True}
    mistaken = lambda see, actions: see["batery_charge_fraction"] > 0.0
    action = lambda see, actions: allow_only(actions, "charge", where=see["time"] > 0.0)
    check_refusals(
        refusal(lambda: columns["time"], KeyError, "'time'", "storage_level_fraction"),
        refusal(lambda: find_teacher("hasty", scanning), ValueError, "imitate='hasty'", "Scanner1", "targets"),
        refusal(lambda: shield(mistaken, scanning), KeyError, "'batery_charge_fraction'", "'battery_charge_fraction'"),
        refusal(lambda: shield(action, scanning), ValueError, "'charge'", "'action_charge'"),
        refusal(lambda: shield(lambda see, _: see["time"] > 0.0, scanning), ValueError, "shield", "torch.bool [2]", [2, 4]),
        refusal(lambda: shield(lambda *_: listed, scanning), ValueError, "shield", listed, [2, 4]),
    )


def test_rejects_wrong_seeds(scanning):
    policy = random_policy(scanning, 0)
    check_refusals(
        refusal(lambda: evaluate(policy, scanning, seed=0, seeds=[0]), ValueError, "seed=0", "seeds=[0]"),
        refusal(lambda: evaluate(policy, scanning, seeds=[]), ValueError, "seed=None", "seeds=[]"),
        refusal(lambda: evaluate(policy, scanning, seeds=[0, 1]), ValueError, "seeds", "env_ids=[0] * num_envs"),
        refusal(lambda: start_episodes(scanning, range(2)), ValueError, "seeds", "env_ids=[0] * num_envs"),
    )


def test_rejects_policies_of_other_observations_and_bounds_of_other_tasks():
    """Those of the package read sets, which these environments do not show."""
    one, crew = (bsk_torch.make(f"{name}-v1", num_envs=1, backend="eager", time_limit=20.0) for name in ("AEOS", "Constellation"))
    imager, member = pretrained("AEOS-v1"), pretrained("Constellation-v1")
    read, advice = "observation.sat_props.", "read_card(file)['options']"
    check_refusals(
        refusal(lambda: evaluate(imager, one, seed=1), ValueError, read, advice),
        refusal(lambda: evaluate(shared(imager, one), one, seed=1), ValueError, read, advice),
        refusal(lambda: evaluate(shared(member, crew), crew, seed=1), ValueError, read, advice),
        refusal(lambda: evaluate(member, crew, seed=1), ValueError, read, "shared(policy, env)"),
    )

    def bound(**sat_args):
        args = {"storedCharge_Init": 1e5} | sat_args
        env = bsk_torch.make("NadirScan-v1", num_envs=1, env_ids=[0], time_limit=2400.0, backend="eager", sat_args=args)
        start_episodes(env, [51])
        most_power(env, torch.tensor([0]))

    panels = [dyn.Panel([0, 0, -1], 0.5, 0.2)] * 2
    check_refusals(
        refusal(lambda: bound(rwMechToElecEfficiency=0.5), ValueError, "rwMechToElecEfficiency", 0, "bound"),
        refusal(lambda: bound(panels=panels), ValueError, "bound", "one solar panel", "list of panels"),
    )


def test_rejects_entrants_and_methods_that_cannot_be_compared():
    nadir = tasks_of("v1", "NadirScan-v1")[0]
    enter = lambda entrant, episodes=1: play(nadir, entrant, episodes)
    able = lambda preset, make: (make(backend="eager"), always(0))
    foreign = nadir.environment(1, backend="eager"), len
    answer, limits = ("NadirScan-v1", "(env, policy)"), f"[1, {EPISODES}]"
    check_refusals(
        refusal(lambda: enter(lambda preset, make: 3), TypeError, *answer, 3),
        refusal(lambda: enter(lambda preset, make: (make(backend="eager"),)), TypeError, *answer, "SatelliteTasking"),
        refusal(lambda: enter(lambda preset, make: foreign), ValueError, "NadirScan-v1", "environment", "make()"),
        refusal(lambda: enter(lambda preset, make: make(time_limit=60.0)), ValueError, "time_limit=60.0", "NadirScan-v1"),
        refusal(lambda: enter(lambda preset, make: make(as_set=True)), TypeError, "'as_set'"),
        refusal(lambda: enter(able, 0), ValueError, "episodes=0", limits),
        refusal(lambda: enter(able, EPISODES + 1), ValueError, f"episodes={EPISODES + 1}", limits),
    )
    one, two = {"x": torch.ones(2, 3)}, {"x": torch.ones(2, 4)}
    check_refusals(
        refusal(lambda: bootstrap({}), ValueError, "methods={}", "one method"),
        refusal(lambda: bootstrap({"a": one | {"y": torch.ones(1, 3)}}), ValueError, "method", {"x": 2, "y": 1}),
        refusal(lambda: bootstrap({"rule": one, "greedy": two}), ValueError, "greedy", {"x": 4}, "rule", {"x": 3}),
        refusal(lambda: bootstrap({"a": {"x": torch.tensor([[torch.nan]])}}), ValueError, "scores of a", "finite"),
    )
