"""Settings that work well, by environment and network."""

from __future__ import annotations

from typing import Any

TAUGHT: dict[str, Any] = dict(imitate="hasty", imitation=0.2)
"""What the rule ``hasty`` does is learned in a minute, and a good start."""

COMMON: dict[str, Any] = dict(num_envs=256, rollout=32, minibatch=1024, gamma=0.997, evaluate_every=200_000)

IMAGING: dict[str, dict[str, Any]] = {
    "mlp": COMMON | dict(hidden=(512, 256), learning_rate=7e-4, epochs=4),
    "attention": COMMON | TAUGHT | dict(hidden=(64,), learning_rate=1e-3, epochs=2, evaluate_every=100_000),
}
"""For choosing targets: what counts is decided within minutes, so the future is discounted accordingly."""

CREW_OF_IMAGERS: dict[str, dict[str, Any]] = {"attention": TAUGHT}
"""For several satellites that choose targets."""

CREW_WITH_RELAYS: dict[str, dict[str, Any]] = {
    "attention": dict(imitate="nearest", imitation=0.2, gamma=0.999, entropy=0.003, evaluate_every=100_000, evaluate_episodes=128)
}
"""Targets are few, so that hardly any has to be left out: the rule that loses the fewest is the start, and haste pays less."""

CLUSTER: dict[str, dict[str, Any]] = {
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

SCANNING: dict[str, dict[str, Any]] = {
    "mlp": dict(evaluate_every=250_000),
    "gru": dict(evaluate_every=250_000, rollout=32, minibatch=4096),
}
"""For the paper's satellite: how well it does goes up and down, so the best policy is looked for often."""

SCIENCE: dict[str, dict[str, Any]] = {"mlp": SCANNING["mlp"] | dict(imitate="science", imitation=0.1)}
"""For fast-saturating wheels: a rule that always survives is a good start, next to which rewards teach to record more."""

SCANNING_WITH_FAULTS = {
    network: recipe | dict(imitate="cautious", imitation=0.1, learning_rate=1e-3) for network, recipe in SCANNING.items()
}
"""A rule that survives most faults is a good start."""

INSPECTION: dict[str, dict[str, Any]] = {
    "attention": dict(
        num_envs=256,
        rollout=16,
        hidden=(256, 256),
        gamma=0.99999,
        epochs=4,
        minibatch=1024,
        entropy=0.01,
        evaluate_every=100_000,
        options=dict(actions="waypoints"),
    ),
}
"""For flying about a spacecraft from waypoint to waypoint. An inspection takes hours, and its end counts most."""

CREW: dict[str, dict[str, Any]] = {
    "attention": INSPECTION["attention"] | dict(num_envs=128, minibatch=512, imitate="survey", imitation=0.3)
}
"""For several inspectors, each step of whom takes longer: smaller batches, so that there are as many updates, and a rule to
begin with."""

SERVICES: dict[str, dict[str, Any]] = {
    "attention": dict(
        num_envs=128,
        rollout=32,
        hidden=(64,),
        learning_rate=1e-3,
        epochs=4,
        minibatch=512,
        gamma=0.9998,
        lmbda=0.9,
        entropy=0.001,
        imitate="candidate_rate_ahead",
        imitation=0.12,
        evaluate_every=0,
        options=dict(order="priority_per_second_ahead", as_set=True, outlook=True, shielded=True, advance=0.9),
    )
}
"""For images that count when they have been verified on the ground: in training, most of the reward is paid in advance when an
image is taken, and candidates that promise the most come first. The shield excludes what a policy would have to learn from few
errors, such as images with a full store. The future of fifty decisions counts."""

CW_DOCKING: dict[str, dict[str, Any]] = {
    "mlp": dict(
        num_envs=256, rollout=64, learning_rate=1e-3, gamma=0.998, lmbda=0.97, entropy=0.0, epochs=4, evaluate_every=500_000
    )
}
"""For docking by thrusters, with a decision in each second: rewards for approaching come within minutes."""

CW_INSPECTION: dict[str, dict[str, Any]] = {
    "mlp": dict(num_envs=256, rollout=64, learning_rate=1e-3, gamma=0.9995, entropy=0.0, epochs=4, evaluate_every=200_000)
}
"""For inspections by thrusters, with a decision every 10 s. A discount of 0.9999 learned more slowly."""

CREW_OF_SENSORS: dict[str, dict[str, Any]] = {
    "attention": dict(
        num_envs=64,
        rollout=32,
        hidden=(64,),
        learning_rate=1e-3,
        epochs=4,
        minibatch=512,
        gamma=0.9995,
        entropy=0.002,
        imitate="prompt_ahead",
        imitation=0.4,
        evaluate_every=0,
        options=dict(as_set=True, outlook=True, shielded=True),
    )
}
"""For imagers of the same objects in orbit, each of which knows its own images: a rule that reacts fast is the start, and the
shield keeps empty downlinks from being explored. Evaluations take longer than the training, so there are none before its end."""

BENCH: dict[str, dict[str, Any]] = {
    "attention": dict(
        num_envs=16,
        rollout=36,
        hidden=(64,),
        learning_rate=5e-4,
        epochs=2,
        minibatch=1024,
        gamma=0.995,
        lmbda=0.9,
        entropy=0.001,
        imitate="soonest_task",
        imitation=0.3,
        evaluate_every=0,
        options=dict(satellites=(4, 24), tasks=(60, 200), candidates=True, as_set=True, step_duration=10.0),
    )
}
"""For satellites that share tasks on the ground: a rule that shares them is the start. The next minutes count."""

RECIPES: dict[str, dict[str, dict[str, Any]]] = {
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
    "Services-v1": SERVICES,
    "ThreeSensors-v1": CREW_OF_SENSORS,
    "Walker4-v1": CREW_OF_SENSORS,
    "AEOSBench-v1": BENCH,
    "RSOInspection-v1": INSPECTION,
    "MultiInspection-v1": CREW,
    "CWDocking-v1": CW_DOCKING,
    "CWInspection-v1": CW_INSPECTION,
}
"""Settings that differ from the defaults of :class:`PPOConfig` or :class:`MAPPOConfig`, by environment and network."""


def recipe_of(preset: str, network: str, options: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the settings of a recipe, none where there is none, and its options of the environment with changed ``options``."""
    recipe = dict(RECIPES.get(preset, {}).get(network, {}))
    return recipe, recipe.pop("options", {}) | options
