"""Settings of trainings that work well, by network."""

from __future__ import annotations

AREAS: dict[str, dict[str, object]] = {
    "mlp": dict(
        frames=1_000_000,
        num_envs=512,
        rollout=32,
        minibatch=2048,
        hidden=(128, 128),
        epochs=6,
        learning_rate=1e-3,
        gamma=0.99995,
        lmbda=0.97,
        entropy=0.004,
        imitate="areas",
        imitation=0.06,
        evaluate_every=500_000,
    )
}
"""For scanning areas; chosen by the trainings of docs/studies/areas.md. The rule teaches first how to survive."""

TEAM: dict[str, dict[str, object]] = {"attention": AREAS["mlp"] | dict(num_envs=192, minibatch=512)}
"""For several satellites: as many decisions in a minibatch."""
