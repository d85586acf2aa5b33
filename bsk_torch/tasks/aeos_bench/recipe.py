"""Settings of trainings that work well, by network."""

from __future__ import annotations

TEAM: dict[str, dict[str, object]] = {
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
