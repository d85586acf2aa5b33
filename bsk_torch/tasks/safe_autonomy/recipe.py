"""Settings of trainings that work well, by network."""

from __future__ import annotations

DOCKING: dict[str, dict[str, object]] = {
    "mlp": dict(
        num_envs=256, rollout=64, learning_rate=1e-3, gamma=0.998, lmbda=0.97, entropy=0.0, epochs=4, evaluate_every=500_000
    )
}
"""For docking by thrusters, with a decision in each second: rewards for approaching come within minutes."""

INSPECTION: dict[str, dict[str, object]] = {
    "mlp": dict(num_envs=256, rollout=64, learning_rate=1e-3, gamma=0.9995, entropy=0.0, epochs=4, evaluate_every=200_000)
}
"""For inspections by thrusters, with a decision every 10 s. A discount of 0.9999 learned more slowly."""
