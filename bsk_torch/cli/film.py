"""``bsk-torch film``: a film of an episode, or a picture of all of it."""

from __future__ import annotations

import io
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase

from bsk_torch.cli.planned import named_actor
from bsk_torch.cli.shared import PICTURES, check_picture, check_writable, environment_options, extra
from bsk_torch.cli.terminal import echo, fail, working
from bsk_torch.env import ConstellationTasking, Tasking
from bsk_torch.env.rollout import play_episodes
from bsk_torch.files import write_file
from bsk_torch.rl.evaluation.evaluate import LOT, with_lots

FILMS = (".gif", ".webp", ".mp4")
"""What the names of films end with."""

Frame = np.ndarray[Any, np.dtype[np.uint8]]
"""Picture [height, width, 3]."""


def film(
    policy: str,
    preset: str | None,
    seed: int,
    out: Path,
    until: float | None,
    every: float | None,
    fps: float,
    height: int,
    plan: list[str] | None,
    threads: int,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Film an episode of a policy, or draw it as one picture; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    check_picture("--out", out, (*FILMS, *PICTURES))
    check_writable(out)
    extra("bsk_torch.viz.render.frames", "viz")
    named = named_actor(policy, preset, plan or ())
    options: dict[str, object] = environment_options(backend, device, time_limit)
    if every is not None:
        options["max_step_duration"] = every
    env = named.environment(1, options)
    if every is not None and not isinstance(env, ConstellationTasking):
        fail(f"--every {every:g} is for constellations, which continue their tasks; {named.preset} would decide more often")
    actor = named.actor(env, device)
    if out.suffix in PICTURES:
        with working("playing the episode"):
            pictures = extra("bsk_torch.viz.episodes", "viz")
            pictures.draw(pictures.record(actor, env, seed=seed), out, f"{named.preset}, seed {seed}, {named.label}")
        told = "the whole episode"
    else:
        player = with_lots(actor, env) if LOT in actor.in_keys else actor
        shots = frames(env, player, seed, until, height)
        told = f"{save_mp4(shots, out, fps) if out.suffix == '.mp4' else save_animation(shots, out, fps)} frames"
    seconds, earned, lost = float(env.fleet.sim_time[0]), float(env.returns[0]), int(env.dead[0].sum())
    echo(f"{out}: {told}, {seconds:,.0f} s of {named.preset}, return {earned:.3f}, satellites lost: {lost}")


def frames(env: Tasking, policy: TensorDictModuleBase, seed: int, until: float | None, height: int) -> Iterator[Frame]:
    """Yield a picture of the start of the first episode of ``seed``, and one after each decision, for ``until`` seconds."""
    env.set_seed(seed)
    start = env.reset()
    with working("filming") as show:
        yield shot(env, height)
        for count, _ in enumerate(play_episodes(env, policy, start), 2):
            show(f"filming: {count} frames, {float(env.fleet.sim_time[0]):,.0f} s")
            yield shot(env, height)
            if until is not None and float(env.fleet.sim_time[0]) >= until:
                return


def shot(env: Tasking, height: int) -> Frame:
    """Return a picture of the present; ends the program for a wrong height."""
    try:
        return np.asarray(env.render(0, height=height).cpu().numpy())
    except ValueError as error:
        fail(str(error))


def save_animation(shots: Iterator[Frame], path: Path, fps: float) -> int:
    """Write a GIF or WebP that repeats for ever; return the number of frames."""
    from PIL import Image

    content = io.BytesIO()
    first, *others = (Image.fromarray(picture) for picture in shots)
    kind = path.suffix.removeprefix(".")
    first.save(content, kind, save_all=True, append_images=others, duration=round(1000.0 / fps), loop=0)
    write_file(path, content.getvalue())
    return 1 + len(others)


def save_mp4(shots: Iterator[Frame], path: Path, fps: float) -> int:
    """Write an MP4; return the number of frames."""
    clips = extra("moviepy.video.io.ImageSequenceClip", "video")
    every = list(shots)
    aside = path.with_name(f".{path.stem}.{secrets.token_hex(8)}.mp4")
    try:
        clips.ImageSequenceClip(every, fps=fps).write_videofile(str(aside), codec="libx264", audio=False, logger=None)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
    return len(every)
