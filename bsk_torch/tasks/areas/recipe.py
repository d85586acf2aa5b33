"""Settings of trainings that work well, by network."""

from __future__ import annotations

AREAS: dict[str, dict[str, object]] = {
    "mlp": dict(
        num_envs=256,
        rollout=32,
        minibatch=1024,
        epochs=6,
        learning_rate=1e-3,
        entropy=0.004,
        evaluate_every=250_000,
    )
}
"""For scanning areas: with small batches, fewer decisions are needed than with the settings for other scanners."""
