"""``bsk-torch film``: a film of an episode, or a picture of all of it."""

from __future__ import annotations

import io
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from bsk_torch.cli.declaration import EnvironmentOptions, OfPreset, Plan, PolicyOrPlanner, Seed, Trust, Until, flag
from bsk_torch.cli.shared import PICTURES, check_file, extra
from bsk_torch.cli.terminal import echo, fail, refusing, working
from bsk_torch.files import write_file

if TYPE_CHECKING:
    from bsk_torch.env import Tasking
    from bsk_torch.env.rollout import Policy

FILMS = (".gif", ".webp", ".mp4")
"""What the names of films end with."""

Frame = NDArray[np.uint8]
"""Picture [height, width, 3]."""


def film(
    policy: PolicyOrPlanner,
    preset: OfPreset = None,
    seed: Seed = 0,
    out: Annotated[
        Path, flag("FILE", "A film (.gif, .webp, .mp4), or a picture of the whole episode (.png, .svg, .pdf).")
    ] = Path("film.gif"),
    until: Until = None,
    every: Annotated[float | None, flag("S", "A frame at least every S seconds; default: one for each decision.")] = None,
    fps: Annotated[float, flag("N", "Frames per second.", min=0.1, max=50.0)] = 5.0,
    height: Annotated[int, flag("N", "Height of a frame in pixels; the width is 4/3 of it.")] = 480,
    plan: Plan = None,
    trust: Trust = False,
    *,
    options: EnvironmentOptions,
) -> None:
    """Film an episode of a policy, or draw it as one picture. Needs the extra viz; .mp4 needs video.

    Examples:
        bsk-torch film runs/scan
        bsk-torch film pretrained --preset Constellation-v1 --until 1200
        bsk-torch film rule --preset NadirScan-v1 --seed 7 --out episode.png
        bsk-torch film random --preset Constellation-v1 --every 20 --out team.mp4
    """
    from bsk_torch.cli.policies import named_actor
    from bsk_torch.env import ConstellationTasking
    from bsk_torch.rl.evaluation.evaluate import with_lots

    check_file("--out", out, (*FILMS, *PICTURES))
    extra("bsk_torch.viz.render.frames")
    named = named_actor(policy, preset, plan, trust)
    env = named.environment(1, options | ({} if every is None else {"max_step_duration": every}))
    if every is not None and not isinstance(env, ConstellationTasking):
        fail(f"--every {every:g} is for constellations, which continue their tasks; {named.preset} would decide more often")
    actor = named.actor(env)
    if out.suffix in PICTURES:
        with working("playing the episode"):
            pictures = extra("bsk_torch.viz.episodes")
            pictures.draw(pictures.record(actor, env, seed=seed), out, f"{named.preset}, seed {seed}, {named.label}")
        content = "the whole episode"
    else:
        shots = frames(env, with_lots(actor, env), seed, until, height)
        content = f"{save_mp4(shots, out, fps) if out.suffix == '.mp4' else save_animation(shots, out, fps)} frames"
    seconds, earned, lost = float(env.fleet.sim_time[0]), float(env.returns[0]), int(env.dead[0].sum())
    echo(f"{out}: {content}, {seconds:,.0f} s of {named.preset}, return {earned:.3f}, satellites lost: {lost}")


def frames(env: Tasking, policy: Policy, seed: int, until: float | None, height: int) -> Iterator[Frame]:
    """Yield a picture of the start of the first episode of ``seed``, and one after each decision, for ``until`` seconds."""
    from bsk_torch.env.rollout import play_episodes

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
    with refusing():
        return np.asarray(env.render(0, height=height).cpu().numpy())


def save_animation(shots: Iterator[Frame], path: Path, fps: float) -> int:
    """Write a GIF or WebP that repeats for ever; return the number of frames."""
    from PIL import Image

    content = io.BytesIO()
    first, *later = (Image.fromarray(picture) for picture in shots)
    kind = path.suffix.removeprefix(".")
    first.save(content, kind, save_all=True, append_images=later, duration=round(1000.0 / fps), loop=0)
    write_file(path, content.getvalue())
    return 1 + len(later)


def save_mp4(shots: Iterator[Frame], path: Path, fps: float) -> int:
    """Write an MP4; return the number of frames."""
    clips = extra("moviepy.video.io.ImageSequenceClip", "video")
    pictures = list(shots)
    aside = path.with_name(f".{path.stem}.{secrets.token_hex(8)}.mp4")
    try:
        clips.ImageSequenceClip(pictures, fps=fps).write_videofile(str(aside), codec="libx264", audio=False, logger=None)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
    return len(pictures)
