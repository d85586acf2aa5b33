"""Settings of trainings that work well, by network."""

from __future__ import annotations

AREAS: dict[str, dict[str, object]] = {
    "mlp": dict(
        num_envs=256,
        rollout=32,
        minibatch=1024,
        epochs=6,
        hidden=(128, 128),
        learning_rate=1.5e-3,
        entropy=0.004,
        gamma=0.9999,
        evaluate_every=250_000,
    )
}
"""For scanning areas: small batches, and a discount of hours, learn twice as fast as the settings for other scanners."""
