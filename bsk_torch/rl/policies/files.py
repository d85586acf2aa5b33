"""Policies in files: weights, what they are built from, and for which environment they were made."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from tensordict.nn import TensorDictSequential

from bsk_torch import __version__
from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.networks.plans import ACTOR, NORMALISER, PLANS, Networks, Plan, check_network

logger = logging.getLogger(__name__)

POLICY = "policy.pt"
"""File of the policy in the folder of a run."""

CARD = {"bsk_torch", "preset", "options", "network", "plan", NORMALISER, ACTOR}
"""Entries of such a file."""


def save_policy(path: Path, plan: Plan, networks: Networks, preset: str, options: Mapping[str, Any]) -> None:
    """Write what :func:`load_policy` needs, and for which environment the policy was made.

    Args:
        path: The file.
        plan: How the networks are built.
        networks: The networks.
        preset: Name of the environment.
        options: Arguments of the environment that differ from the preset's; only plain values are kept.
    """
    kind = next(name for name, known in PLANS.items() if type(plan) is known)
    card = {"bsk_torch": __version__, "preset": preset, "options": plain(options), "network": kind}
    part = path.with_suffix(".part")
    torch.save(card | {"plan": dataclasses.asdict(plan)} | networks.policy_state(), part)
    part.replace(path)  # so that no reader finds half a file


def plain(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are numbers, words, or lists of them; machines and backends are no part of the problem."""
    simple = (bool, int, float, str)
    return {
        name: value
        for name, value in options.items()
        if name not in ("backend", "device")
        and (isinstance(value, simple) or (isinstance(value, list | tuple) and all(isinstance(v, simple) for v in value)))
    }


def read_card(path: Path | str, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read the file of a policy, or that of a run's folder: ``preset``, ``options``, ``network``, ``plan`` and weights.

    Raises:
        ValueError: For a file that is no policy of this package.
        FileNotFoundError: Where there is none.
    """
    path = Path(path)
    path = path / POLICY if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(f"there is no policy {str(path)!r}; training leaves {POLICY} in its folder")
    try:
        card = torch.load(path, weights_only=True, map_location=device)
    except (RuntimeError, UnpicklingError, EOFError) as error:
        reason = str(error).partition("\n")[0].partition(". ")[0]  # torch says much more
        raise ValueError(f"{str(path)!r} is no file of a policy: {reason}") from error
    if not isinstance(card, dict) or CARD - card.keys():
        raise ValueError(f"{str(path)!r} is no policy of this version of bsk_torch ({__version__}); train it again")
    check_network(card["network"])
    return card


def check_fits(card: Mapping[str, Any], env: SatelliteTasking, preset: str | None = None) -> None:
    """ValueError, naming both sides, unless the policy of ``card`` sees and does what there is in ``env``, a ``preset``."""
    kind, plan = PLANS[card["network"]], card["plan"]
    here = dataclasses.asdict(kind.of(env, plan["hidden"]))
    differing = [name for name in here if _listed(here[name]) != _listed(plan[name])]
    if differing:
        theirs, ours = (", ".join(f"{name}={values[name]}" for name in differing) for values in (plan, here))
        trained = " ".join([card["preset"], *(f"{name}={value!r}" for name, value in card["options"].items())])
        raise ValueError(f"the policy was trained for {trained} with {theirs}; {preset or 'this environment'} has {ours}")
    if card["bsk_torch"] != __version__:
        logger.warning("the policy is of bsk_torch %s; this is %s", card["bsk_torch"], __version__)


def _listed(value: Any) -> Any:
    return [_listed(part) for part in value] if isinstance(value, list | tuple) else value


def load_policy(path: Path | str, device: torch.device | str = "cpu") -> TensorDictSequential:
    """The policy of a file or of a run's folder; see :func:`read_card` for errors."""
    return build_policy(read_card(path, device), device)


def build_policy(card: Mapping[str, Any], device: torch.device | str = "cpu") -> TensorDictSequential:
    """The policy of a card; ValueError if its weights do not fit its plan."""
    networks = PLANS[card["network"]](**card["plan"]).build().to(device)
    try:
        networks.load_policy_state(card)
    except RuntimeError as error:
        raise ValueError(f"the policy of {card['preset']} does not fit this version of bsk_torch: {error}") from error
    return networks.policy
