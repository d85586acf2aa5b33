"""Settings of trainings that work well, by network."""

from __future__ import annotations

IMAGER: dict[str, dict[str, object]] = {
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

TEAM: dict[str, dict[str, object]] = {
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
