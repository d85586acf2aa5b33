"""Settings of trainings that work well, by network."""

from __future__ import annotations

INSPECTOR: dict[str, dict[str, object]] = {
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

CREW: dict[str, dict[str, object]] = {
    "attention": INSPECTOR["attention"] | dict(num_envs=128, minibatch=512, imitate="survey", imitation=0.3)
}
"""For several inspectors, each step of whom takes longer: smaller batches, so that there are as many updates, and a rule to
begin with."""
