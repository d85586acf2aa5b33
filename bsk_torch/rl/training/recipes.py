"""Settings that work well, by environment and network."""

from __future__ import annotations

from typing import Any

from bsk_torch._rooms import Entries

Settings = dict[str, Any]
"""Settings of a training by name."""

TAUGHT: Settings = dict(imitate="hasty", imitation=0.2)
"""What the rule ``hasty`` does is learned in a minute, and a good start."""

COMMON: Settings = dict(num_envs=256, rollout=32, minibatch=1024, gamma=0.997, evaluate_every=200_000)

IMAGING: dict[str, Settings] = {
    "mlp": COMMON | dict(hidden=(512, 256), learning_rate=7e-4, epochs=4),
    "attention": COMMON | TAUGHT | dict(hidden=(64,), learning_rate=1e-3, epochs=2, evaluate_every=100_000),
}
"""For choosing targets: what counts is decided within minutes, so the future is discounted accordingly."""

CREW_OF_IMAGERS: dict[str, Settings] = {"attention": TAUGHT}
"""For several satellites that choose targets."""

CREW_WITH_RELAYS: dict[str, Settings] = {
    "attention": dict(imitate="nearest", imitation=0.2, gamma=0.999, entropy=0.003, evaluate_every=100_000, evaluate_episodes=128)
}
"""Targets are few, so that hardly any has to be left out: the rule that loses the fewest is the start, and haste pays less."""

CLUSTER: dict[str, Settings] = {
    "attention": dict(
        num_envs=64,
        rollout=48,
        hidden=(32,),
        epochs=3,
        minibatch=512,
        learning_rate=2e-3,
        imitate="cooperative",
        imitation=0.5,
        imitation_temperature=0.1,
        gamma=0.999,
        evaluate_every=80_000,
        evaluate_episodes=48,
    )
}
"""For satellites with different instruments: which targets to leave to others is taught. New episodes search for the windows of
5,000 targets, so there are few at once."""

SCANNING: dict[str, Settings] = {
    "mlp": dict(evaluate_every=250_000),
    "gru": dict(evaluate_every=250_000, rollout=32, minibatch=4096),
}
"""For the paper's satellite: how well it does goes up and down, so the best policy is looked for often."""

SCIENCE: dict[str, Settings] = {"mlp": SCANNING["mlp"] | dict(imitate="science", imitation=0.1)}
"""For fast-saturating wheels: a rule that always survives is a good start, next to which rewards teach to record more."""

SCANNING_WITH_FAULTS = {
    network: recipe | dict(imitate="cautious", imitation=0.1, learning_rate=1e-3) for network, recipe in SCANNING.items()
}
"""A rule that survives most faults is a good start."""

RECIPES: Entries[dict[str, Settings]] = Entries(
    {
        "NadirScan-v1": SCANNING,
        "NadirScience-v1": SCIENCE,
        "FaultyScan-v1": SCANNING_WITH_FAULTS,
        "AEOS-v1": IMAGING,
        "AEOSPower-v1": IMAGING,
        "AEOSCity-v1": IMAGING,
        "CloudyAEOS-v1": IMAGING,
        "Constellation-v1": CREW_OF_IMAGERS,
        "AEOSConstellation-v1": CREW_OF_IMAGERS,
        "RelayConstellation-v1": CREW_WITH_RELAYS,
        "HeteroCluster-v1": CLUSTER,
        "Services-v1": "bsk_torch.tasks.objects.recipe:IMAGER",
        "ThreeSensors-v1": "bsk_torch.tasks.objects.recipe:TEAM",
        "Walker4-v1": "bsk_torch.tasks.objects.recipe:TEAM",
        "AEOSBench-v1": "bsk_torch.tasks.aeos_bench.recipe:TEAM",
        "Areas-v1": "bsk_torch.tasks.areas.recipe:AREAS",
        "AreasTeam-v1": "bsk_torch.tasks.areas.recipe:TEAM",
        "Sites-v1": "bsk_torch.tasks.sites.recipe:SITES",
        "SitesTeam-v1": "bsk_torch.tasks.sites.recipe:TEAM",
        "TipAndCue-v1": "bsk_torch.tasks.sites.recipe:SITES",
        "RSOInspection-v1": "bsk_torch.tasks.inspection.recipe:INSPECTOR",
        "MultiInspection-v1": "bsk_torch.tasks.inspection.recipe:CREW",
        "CWDocking-v1": "bsk_torch.tasks.safe_autonomy.recipe:DOCKING",
        "CWInspection-v1": "bsk_torch.tasks.safe_autonomy.recipe:INSPECTION",
    }
)
"""Settings that differ from the defaults of :class:`PPOConfig` or :class:`MAPPOConfig`, by environment and network."""


def recipe_of(preset: str, network: str, options: dict[str, object]) -> tuple[Settings, Settings]:
    """Return the settings of a recipe, none where there is none, and its options of the environment with changed ``options``."""
    recipe = dict(RECIPES.get(preset, {}).get(network, {}))
    return recipe, recipe.pop("options", {}) | options
