"""Frames of videos: the globe, the satellites and what they do, as arrays of pixels. ``env.render()`` returns them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from bsk_torch.viz.render.closeup import CloseUp, body, draw_closeup, look_closely, write_closeup_names
from bsk_torch.viz.render.globe import camera, globe
from bsk_torch.viz.render.marks import Pen, draw_marks, write_names
from bsk_torch.viz.render.moment import Array, Moment, look
from bsk_torch.viz.render.panel import write_inspection_panel, write_panel

if TYPE_CHECKING:
    from bsk_torch.env.base import Tasking

MOST = 16
"""Default maximum number of drawn episodes; more would take seconds and fill the memory."""

LEAST_HEIGHT, USUAL_HEIGHT = 120, 480
"""Pixels."""

SMOOTH = 2
"""Marks are drawn this much larger and then made smaller, which smooths their edges."""


def frames(env: Tasking, rows: int | Sequence[int] | None = None, height: int = USUAL_HEIGHT) -> Tensor:
    """Pictures of the present of some episodes; see :meth:`bsk_torch.env.base.Tasking.render`."""
    if not isinstance(height, int) or height < LEAST_HEIGHT or height % 2:
        raise ValueError(f"height={height!r} must be an even number of pixels, at least {LEAST_HEIGHT}")
    moments = [(row, look(env, row)) for row in chosen(env, rows)]
    pictures = [picture(moment, height, look_closely(env, row, moment)) for row, moment in moments]
    shots = torch.from_numpy(np.stack(pictures)).to(env.device)
    return shots[0] if isinstance(rows, int) else shots


def chosen(env: Tasking, rows: int | Sequence[int] | None) -> list[int]:
    """The episodes to draw; ValueError for wrong ones, ResetNeededError for those that have not begun."""
    n = env.batch_size[0]
    if rows is None and n > MOST:
        raise ValueError(
            f"rows=None draws every environment, and num_envs={n} is more than the {MOST} drawn by default; "
            "choose some, such as rows=0 or rows=[0, 1]"
        )
    episodes = list(range(n)) if rows is None else [rows] if isinstance(rows, int) else list(rows)
    if not episodes or any(not 0 <= row < n for row in episodes):
        raise ValueError(f"rows={rows!r} must be an environment from 0 to {n - 1}, or a list of such")
    env.guard.check_begun(
        "render()", torch.zeros_like(env.state.begun).index_fill(0, torch.tensor(episodes, device=env.device), True)
    )
    return episodes


def picture(moment: Moment, height: int, close: CloseUp | None = None) -> Array:
    """A frame, [height, 4/3 height, 3] uint8: the globe, or an inspection from nearby."""
    width, unit, eye = 2 * round(2 * height / 3), height / USUAL_HEIGHT, camera(moment, height)
    frame = Image.new("RGB", (width, height), "white")
    marks = Image.new("RGBA", (SMOOTH * width, SMOOTH * height))
    large, pen = Pen(ImageDraw.Draw(marks), eye.enlarged(SMOOTH), SMOOTH * unit), Pen(ImageDraw.Draw(frame), eye, unit)
    if close is None:
        frame.paste(Image.fromarray(globe(eye, moment, height)))
        draw_marks(large, moment)
    else:
        sphere, corner = body(close, height)
        frame.paste(sphere, corner, sphere)
        draw_closeup(large, moment, close)
    marks = marks.reduce(SMOOTH)
    frame.paste(marks, mask=marks)
    if close is None:
        write_names(pen, moment)
        write_panel(pen, moment, left=height, width=width - height)
    else:
        write_closeup_names(pen, moment, close)
        write_inspection_panel(pen, moment, close, left=height, width=width - height)
    return np.asarray(frame)
