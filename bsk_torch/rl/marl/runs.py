"""Trainings by the kind of environment: PPO for one satellite, MAPPO or IPPO for constellations."""

from __future__ import annotations

import inspect
import re
import shlex
import sys
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from tensordict.nn import TensorDictModuleBase

from bsk_torch._listed import LISTED
from bsk_torch.env import ConstellationTasking
from bsk_torch.presets import PRESETS, make
from bsk_torch.presets.own import OwnEnvironment
from bsk_torch.rl.evaluation.evaluate import FRESH, Evaluation, evaluate
from bsk_torch.rl.evaluation.results import EVALUATION, TRAINED, Comparison, compare, print_results, save_results
from bsk_torch.rl.marl.mappo import CRITICS, MAPPOConfig, MAPPOTraining
from bsk_torch.rl.networks.plans import check_network
from bsk_torch.rl.policies.files import objects_in
from bsk_torch.rl.policies.shared_policy import baseline, shared
from bsk_torch.rl.training.config import CONFIG, PPOConfig, check_setting, load_config, read_settings
from bsk_torch.rl.training.imitation import OWN, enter_teacher
from bsk_torch.rl.training.recipes import RECIPES, recipe_of
from bsk_torch.rl.training.trainer import Training
from bsk_torch.rl.training.verdict import compared_episodes, verdict
from bsk_torch.sim.arguments.values import nearest

PPO = "ppo"
"""Algorithm for one satellite."""

ALGORITHMS = (PPO, *CRITICS)
"""Algorithms by which policies are trained."""


def is_constellation(preset: str, options: Mapping[str, object] | None = None) -> bool:
    """Return whether a preset has many satellites; False for a name that is not one of the presets.

    A preset without a class as its return annotation, such as one whose options ask for several satellites, is built with
    ``options`` to find its class.
    """
    if preset not in PRESETS:
        return False
    function = PRESETS[preset]
    if isinstance(function, OwnEnvironment):
        return isinstance(function.sample, ConstellationTasking)
    annotation = inspect.signature(PRESETS[preset], eval_str=True).return_annotation
    if annotation is inspect.Signature.empty or not isinstance(annotation, type):
        return isinstance(make(preset, **({"num_envs": 1, "backend": "eager"} | dict(options or {}))), ConstellationTasking)
    return issubclass(annotation, ConstellationTasking)


def configure(preset: str, network: str | None = None, algorithm: str | None = None, **changes: Any) -> PPOConfig:
    """Return the configuration of a training, with the recipe for the environment if there is one.

    Args:
        preset: Name of the environment.
        network: See :class:`PPOConfig`; None for ``"attention"`` with many satellites, or a recipe for it; else ``"mlp"``.
        algorithm: One of :data:`ALGORITHMS`; None for ``"ppo"`` with one satellite and ``"mappo"`` with many.
        **changes: Fields of :class:`PPOConfig` or :class:`MAPPOConfig` that differ from the recipe.

    Raises:
        ValueError: For an unknown algorithm, network or setting, or one that does not fit the environment.
    """
    many = is_constellation(preset, changes.get("options"))
    attentive = many or "attention" in RECIPES.get(preset, {})
    algorithm, network = algorithm or ("mappo" if many else PPO), network or ("attention" if attentive else "mlp")
    check_network(network)
    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm={algorithm!r} must be one of {', '.join(ALGORITHMS)}; {nearest(algorithm, ALGORITHMS)}")
    if many == (algorithm == PPO):
        has, fitting = ("many satellites", " or ".join(CRITICS)) if many else ("one satellite", PPO)
        raise ValueError(f"algorithm={algorithm!r} does not train {preset}, which has {has}; use {fitting}")
    recipe, options = recipe_of(preset, network, changes.pop("options", {}))
    if network == "attention" and preset in PRESETS and "as_set" in inspect.signature(PRESETS[preset]).parameters:
        options = {"as_set": True} | options
    if isinstance(changes.get("imitate"), str):
        changes["imitate"] = enter_teacher(changes["imitate"])
    kind = MAPPOConfig if many else PPOConfig
    for name in changes:
        check_setting(name, kind)
    settings = {"network": network, "options": options} | recipe | changes | ({"algorithm": algorithm} if many else {})
    return kind(preset, **settings)


def algorithm_of(config: PPOConfig) -> str:
    """Return the algorithm of a configuration, one of :data:`ALGORITHMS`."""
    return config.algorithm if isinstance(config, MAPPOConfig) else PPO


def read_config(folder: Path | str) -> PPOConfig:
    """Return the configuration of the run in a folder; ValueError if it is not one of this version."""
    path = Path(folder) / CONFIG
    return load_config(path, MAPPOConfig if "algorithm" in read_settings(path) else PPOConfig)


def training_of(config: PPOConfig, out: Path | str, resume: bool = False) -> Training:
    """Return the training of a configuration; see :class:`~bsk_torch.rl.training.trainer.Training` for arguments and errors.

    ValueError for an environment that the algorithm of the configuration does not train, too.
    """
    many = is_constellation(config.preset, config.options)
    if config.preset in PRESETS and many != isinstance(config, MAPPOConfig):
        has, kind = ("many satellites", "MAPPOConfig") if many else ("one satellite", "PPOConfig")
        call = f"configure({config.preset!r}, options={config.options})"
        raise ValueError(f"{config.preset} has {has}, and is trained by a {kind}; {call} makes it")
    return (MAPPOTraining if isinstance(config, MAPPOConfig) else Training)(config, Path(out), resume)


def train(config: PPOConfig, out: Path | str, *, episodes: int | None = None, quiet: bool = False) -> TensorDictModuleBase:
    """Train a policy, compare it with random actions, rules and the untrained policy, and leave all of it in folder ``out``.

    Training ends with a table of unseen episodes, the folder, the next command, and whether the policy is better than the best
    rule, on the standard output; ``evaluation.json`` in the folder has the numbers.

    Args:
        config: What to train and how.
        out: The folder of the run; it must not hold anything yet.
        episodes: Number of unseen episodes of the comparison; 0 for none. By default 256, fewer where they take long.
        quiet: Show neither the progress bar nor the table. Warnings are logged as always.

    Returns:
        The policy: writes ``action`` into a tensordict with ``observation`` and ``action_mask``. For a constellation it is the
        policy of one satellite, or a ``GroupPolicies``; :func:`~bsk_torch.rl.marl.shared` applies it to all satellites.

    Raises:
        ValueError: For an environment that the algorithm of the configuration does not train, or negative ``episodes``.
    """
    check_episodes(episodes)
    return completed(training_of(config, out), episodes, quiet, ("untrained",))[0]


def resume(out: Path | str, *, episodes: int | None = None, quiet: bool = False) -> TensorDictModuleBase:
    """Resume the run in folder ``out``, which an interruption or the end of its budget has left; see :func:`train`."""
    check_episodes(episodes)
    return completed(training_of(read_config(out), out, resume=True), episodes, quiet)[0]


def check_episodes(episodes: int | None) -> None:
    """Raise ValueError for a negative number of episodes."""
    if episodes is not None and episodes < 0:
        raise ValueError(f"episodes={episodes} must be at least 0; 0 compares nothing")


def completed(
    run: Training, episodes: int | None, quiet: bool, before: Collection[str] = (), kept: bool = True
) -> tuple[TensorDictModuleBase, Comparison]:
    """Train, compare the policy in as many unseen ``episodes``, under the name of ``before`` also as it is now, and tell.

    None for :func:`compared_episodes`. The folder of the run remains if it is ``kept``. Returns the policy of one satellite, and
    the comparison.
    """
    config = run.config
    episodes = compared_episodes(config) if episodes is None else episodes
    if not episodes:
        return run.run(bar=not quiet), Comparison()
    env = make(config.preset, num_envs=episodes, **config.options)
    teacher = {config.imitate: shared(baseline(config.imitate, env), env)} if config.imitate in OWN else {}
    results = {name: evaluate(shared(run.policy, env), env, seed=config.seed + FRESH) for name in before}
    policy = run.run(bar=not quiet)
    comparison = compare({TRAINED: shared(policy, env), **teacher}, env, config.seed)
    results = Comparison(
        {name: comparison[name] for name in comparison if name != TRAINED} | results | {TRAINED: comparison[TRAINED]}
    )
    save_results(results, run.out / EVALUATION, TRAINED)
    if not quiet:
        print_results(results, f"{config.preset}, {episodes} unseen episodes", TRAINED)
        sys.stdout.write(f"{told(run, results)}\n" if kept else "")
    return policy, results


def told(run: Training, results: Mapping[str, Evaluation]) -> str:
    """Return where the results of a run are, what to do next, and the :func:`verdict` on its ``results``, if there are any.

    That is the command for a report, also that for resuming an interrupted run, or a call where only the user's program has the
    preset or parts of the environment.
    """
    config, folder = run.config, shlex.quote(str(run.out))
    objects = objects_in(config.options)
    own = re.fullmatch(r"(?!__main__:|own:)[^<>]+:[^<>]+", config.preset)
    if own and not objects:
        lines = f"results: {run.out}\nnext: bsk-torch report {folder} --preset {shlex.quote(config.preset)}"
    elif config.preset not in LISTED or objects:
        lines = f"results: {run.out}\nnext: bsk_torch.load_policy({str(run.out)!r}, env)"
    else:
        resumed = f"bsk-torch train {folder} --resume, or " if run.interrupted else ""
        lines = f"results: {run.out}\nnext: {resumed}bsk-torch report {folder}"
    return f"{lines}\n{verdict(results, config.preset)}".rstrip() if TRAINED in results else lines
