"""Train in your own environment by one call."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from tensordict.nn import TensorDictModuleBase

from bsk_torch.env import SatelliteTasking
from bsk_torch.presets import PRESETS
from bsk_torch.presets.own import OwnEnvironment, Source, enter, enter_named
from bsk_torch.rl.evaluation.evaluate import Evaluation
from bsk_torch.rl.evaluation.results import TRAINED, Comparison
from bsk_torch.rl.marl.runs import check_episodes, completed, configure, read_config, training_of
from bsk_torch.rl.networks.plans import observed_sets
from bsk_torch.rl.policies.shared_policy import shared
from bsk_torch.rl.training.config import PPOConfig

__all__ = ["Trained", "train"]


@dataclass(frozen=True)
class Trained:
    """What :func:`train` leaves.

    Attributes:
        policy: The policy, for all satellites of the environment.
        results: Results of this policy (``"trained"``), the untrained one, the rules that apply, and random actions in the same
            unseen episodes, by name; empty if there was no comparison.
        config: The settings.
        folder: Folder of the run; None if there is none.
    """

    policy: TensorDictModuleBase
    results: Comparison
    config: PPOConfig
    folder: Path | None

    @property
    def evaluation(self) -> Evaluation | None:
        """Results of the policy in unseen episodes; None if there was no comparison."""
        return self.results.get(TRAINED)


def train(
    env: Source | str,
    *,
    seconds: float | None = None,
    frames: int | None = None,
    seed: int = 0,
    folder: Path | str | None = None,
    resume: bool = False,
    network: str | None = None,
    algorithm: str | None = None,
    episodes: int | None = None,
    quiet: bool = False,
    **settings: object,
) -> Trained:
    """Train a policy in an environment, and compare it with random actions and rules in unseen episodes.

    One satellite is trained by PPO, a constellation by MAPPO; see :class:`~bsk_torch.rl.training.PPOConfig`. With ``frames``, the
    same seed gives the same weights again. Policies of several seeds differ: judge a task or a method by five of them.

    Args:
        env: An environment; a function of ``num_envs`` that makes one; the name of a preset; or the name of a function,
            ``"module:name"`` or ``"file.py:name"``. The number of episodes at once is the setting ``num_envs``, whatever the
            environment's: others are made like it.
        seconds: Training time after compilation, s; by default 180 unless there are ``frames``.
        frames: Number of decisions.
        seed: Seed of networks, actions and episodes.
        folder: Folder for policy, logs and checkpoint, which must not hold anything yet; None for none.
        resume: Resume the run in ``folder`` with the environment ``env`` and the settings that it was begun with. New limits
            ``seconds`` and ``frames`` replace the old ones.
        network: ``"mlp"``, ``"gru"`` or ``"attention"``; by default ``"attention"`` for constellations and for satellites that
            observe a set of targets, ``"mlp"`` for others.
        algorithm: ``"ppo"``, ``"mappo"`` or ``"ippo"``.
        episodes: Number of unseen episodes of the comparison; 0 for no comparison. By default 256, fewer where they take long.
        quiet: Show neither progress nor results.
        **settings: Other settings that differ from the defaults, or the recipe of a preset, such as ``num_envs=256``,
            ``imitate=my_rule`` or ``options={"time_limit": 600.0}``.

    Raises:
        TypeError: For anything else in the place of an environment.
        ValueError: For a setting that is unknown or does not fit the environment, or ``resume`` without a folder.
        FileExistsError: If there is something in ``folder``.
    """
    check_episodes(episodes)
    if resume and folder is None:
        raise ValueError("resume=True needs the folder of the run")
    limits = {name: value for name, value in (("seconds", seconds), ("frames", frames)) if value is not None}
    if resume:
        if settings or network or algorithm:
            raise ValueError(f"resume=True keeps the settings of the run; {[*settings] or 'network, algorithm'} cannot change")
        config = read_config(folder)  # type: ignore[arg-type]
        if not isinstance(env, str):
            enter(env, config.preset)
        config = replace(config, seconds=seconds, frames=frames) if limits else config
    else:
        preset = _entered(env)
        if network is None and _observes_set(preset):
            network = "attention"
        config = configure(preset, network, algorithm, seed=seed, **limits, **settings)
    with TemporaryDirectory() if folder is None else nullcontext(folder) as out:
        run = training_of(config, out, resume)
        policy, results = completed(run, episodes, quiet, () if resume else ("untrained",), kept=folder is not None)
    for_all = shared(policy, run.env)
    return Trained(for_all, results, run.config, None if folder is None else Path(folder))


def _entered(env: Source | str) -> str:
    """Return the name among the presets of an environment, or of what makes it."""
    if not isinstance(env, str):
        return enter(env)
    if ":" in env:
        enter_named(env)
    return env


def _observes_set(preset: str) -> bool:
    """Return whether the satellite of an environment of the user's observes a set of targets."""
    own = PRESETS.get(preset)
    return isinstance(own, OwnEnvironment) and isinstance(own.sample, SatelliteTasking) and bool(observed_sets(own.sample))
