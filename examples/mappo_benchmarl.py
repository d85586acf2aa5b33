"""
MAPPO and IPPO with BenchMARL
=============================

Train a small constellation with BenchMARL, and compare it with rules on unseen episodes.

Install BenchMARL without its dependencies, because it declares an older TorchRL::

    pip install --no-deps benchmarl==1.5.2
    python examples/mappo_benchmarl.py --iterations 60

To benchmark a policy trained on a full preset::

    python examples/mappo_benchmarl.py --preset RelayConstellation-v1 --iterations 60 --policy runs/relay_mappo.pt
    bsk-torch bench examples.mappo_benchmarl:entrant,runs/relay_mappo.pt hasty --presets RelayConstellation-v1
"""

# sphinx_gallery_thumbnail_path = "_static/readme/RelayConstellation-v1.png"

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from bsk_torch.rl.evaluation import FRESH, compare, comparison_table, evaluate

# import this first: it makes BenchMARL compatible with newer versions of TorchRL
from bsk_torch.rl.marl.benchmarl import PRESET, ConstellationTask

# isort: split
from benchmarl.algorithms import IppoConfig, MappoConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig

ALGORITHMS = {"mappo": MappoConfig, "ippo": IppoConfig}

TASKS = {preset: name for name, preset in PRESET.items()}
"""Names of BenchMARL's tasks by preset."""

SMALL = {
    "Constellation-v1": {
        "n_satellites": 4,
        "n_planes": 2,
        "n_targets": 1000,
        "time_limit": 2850.0,
    }
}
"""Arguments that make presets smaller by default."""


def experiment_config(options: argparse.Namespace) -> ExperimentConfig:
    """BenchMARL's settings for batched environments with steps of minutes."""
    config = ExperimentConfig.get_from_yaml()
    changes: dict[str, Any] = dict(
        gamma=options.gamma,
        lr=7e-4,
        max_n_iters=options.iterations,
        max_n_frames=None,
        on_policy_n_envs_per_worker=options.num_envs,
        on_policy_collected_frames_per_batch=options.num_envs * options.rollout,
        on_policy_minibatch_size=1024,
        on_policy_n_minibatch_iters=4,
        evaluation=False,
        render=False,
        loggers=["csv"],
        create_json=False,
        save_folder=str(options.out),
    )
    for name, value in changes.items():
        setattr(config, name, value)
    return config


def make_experiment(options: argparse.Namespace) -> Experiment:
    """Return the experiment, ready to run."""
    given = {
        name: getattr(options, name)
        for name in ("n_satellites", "n_planes", "n_targets", "time_limit")
    }
    world = SMALL.get(options.preset, {}) | {
        name: value for name, value in given.items() if value is not None
    }
    algorithm, model = (
        ALGORITHMS[options.algorithm].get_from_yaml(),
        MlpConfig.get_from_yaml(),
    )
    algorithm.entropy_coef, model.num_cells = 0.01, [256, 256]
    return Experiment(
        task=ConstellationTask[TASKS[options.preset]].get_task({"options": world}),
        algorithm_config=algorithm,
        model_config=model,
        seed=options.seed,
        config=experiment_config(options),
    )


def entrant(preset: str, make: Callable[..., Any], file: str) -> tuple[Any, Any] | None:
    """Enter the policy of a file in ``bsk-torch bench``; None for other presets than that of its training."""
    kept = torch.load(file, weights_only=False)  # modules: load your own files only
    return (make(), kept["policy"]) if kept["preset"] == preset else None


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description="Train a constellation with BenchMARL."
    )
    parser.add_argument("--algorithm", default="mappo", choices=sorted(ALGORITHMS))
    parser.add_argument(
        "--iterations", type=int, default=60, help="number of training batches"
    )
    parser.add_argument("--num-envs", type=int, default=128, help="episodes at once")
    parser.add_argument(
        "--rollout", type=int, default=32, help="steps per episode between two updates"
    )
    parser.add_argument("--gamma", type=float, default=0.99, help="discount per step")
    parser.add_argument(
        "--preset",
        default="Constellation-v1",
        choices=sorted(TASKS),
        help="made smaller by the next options",
    )
    parser.add_argument("--n-satellites", type=int, help="4 in Constellation-v1")
    parser.add_argument("--n-planes", type=int, help="2 in Constellation-v1")
    parser.add_argument("--n-targets", type=int, help="1,000 in Constellation-v1")
    parser.add_argument(
        "--time-limit",
        type=float,
        help="length of an episode, s; 2,850 in Constellation-v1",
    )
    parser.add_argument(
        "--episodes", type=int, default=256, help="unseen episodes per evaluation"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, default=Path("runs"), help="folder for BenchMARL's logs"
    )
    parser.add_argument(
        "--policy", type=Path, help="file for the policy, for use with entrant()"
    )
    parser.add_argument(
        "--figure",
        type=Path,
        help="file for a figure of an episode; needs the extra viz",
    )
    return parser.parse_args()


def main() -> None:
    """Evaluate, train, evaluate."""
    options = arguments()
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    experiment = make_experiment(options)
    env = experiment.task.get_env_fun(options.episodes, False, options.seed, "cpu")()
    untrained = evaluate(experiment.policy, env, seed=options.seed + FRESH)
    experiment.run()
    if options.policy is not None:
        torch.save(
            {"preset": options.preset, "policy": experiment.policy}, options.policy
        )
    results = compare({options.algorithm: experiment.policy}, env, options.seed)
    print(comparison_table(results | {"untrained": untrained}))
    if options.figure is not None:
        from bsk_torch.viz.episodes import draw, record

        draw(
            record(experiment.policy, env, seed=options.seed + FRESH),
            options.figure,
            "BenchMARL",
        )


if __name__ == "__main__":
    main()
