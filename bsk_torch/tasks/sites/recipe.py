"""Settings of trainings that work well, by network."""

from __future__ import annotations

SITES: dict[str, dict[str, object]] = {
    "attention": dict(
        frames=180_000,
        num_envs=256,
        rollout=16,
        hidden=(64,),
        learning_rate=1e-3,
        epochs=2,
        minibatch=512,
        gamma=0.996,
        entropy=0.005,
        imitate="commit",
        imitation=0.1,
        evaluate_every=36_000,
        evaluate_episodes=128,
    )
}
"""For sites: the rule that commits to what can be finished is learned first. What counts is decided within minutes."""

TEAM: dict[str, dict[str, object]] = {
    "attention": SITES["attention"]
    | dict(frames=250_000, num_envs=64, rollout=32, entropy=0.003, imitation=0.12, evaluate_every=50_000)
}
"""For two satellites: smaller batches, and more of them."""
