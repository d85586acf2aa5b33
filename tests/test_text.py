"""Names from files with escape sequences, hidden characters and formulas, wherever people read them."""

import io
import logging
import re
import sys
from contextlib import redirect_stderr, redirect_stdout
from html import escape

import pytest
import torch
from matplotlib import rcParams
from PIL import Image, ImageDraw
from rich.console import Console

from bsk_torch._text import visible
from bsk_torch.bsk_rl.utils.logging_config import SimFormatter
from bsk_torch.cli import terminal
from bsk_torch.env.log import SimulationFormatter
from bsk_torch.tables import print_table
from bsk_torch.viz.figures.curves import performance_profiles
from bsk_torch.viz.render.marks import Pen
from bsk_torch.viz.report.curves import deaths_chart

NAME = "\x1b]0;owned\x07\x9b2J\r\u202eevil\u2028[/red]$\\frac{$"
"""Sets the title of a window, clears the screen, turns the direction of text, ends markup, begins a formula."""

SHOWN = r"\x1b]0;owned\x07\x9b2J\r\u202eevil\u2028[/red]$\frac{$"


def test_hidden_characters_are_escapes():
    assert (visible(NAME), visible("a\tb\n\ud800")) == (SHOWN, "a\tb\n\\ud800")
    assert visible("a\nb", keep="") == "a\\nb"
    plain = "Żółć 衛星 🛰 1\u202f000\u00a0km"
    assert visible(plain) == plain


def activity_shown():
    """What a spinner shows, on a terminal."""
    out = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terminal, "screen", Console(file=out, force_terminal=True, color_system=None, width=200))
        with terminal.working(NAME):
            pass
    sys.stdout.write(re.sub(r"\x1b\[(\?25[lh]|[12][KA])|\r", "", out.getvalue()))  # what moves the bar


def failed():
    with pytest.raises(terminal.Failure):
        terminal.fail(NAME)


def logged(formatter):
    record = logging.LogRecord(f"bsk_rl.sats.satellite.{NAME}", logging.INFO, "", 0, "renamed %s", (NAME,), None)
    record.satellite = NAME
    return formatter.format(record)


@pytest.mark.parametrize(
    "show",
    [
        lambda: print_table([{NAME: "1"}]),
        lambda: print_table([{"policy": NAME}], f"title {NAME}"),
        lambda: terminal.print_message(NAME),
        lambda: terminal.echo(NAME),
        lambda: sys.stdout.write(logged(SimulationFormatter())),
        lambda: sys.stdout.write(logged(SimFormatter(color_output=False))),
        failed,
        activity_shown,
    ],
)
def test_terminals_show_names_as_they_are(show):
    out = io.StringIO()
    with redirect_stdout(out), redirect_stderr(out), pytest.MonkeyPatch.context() as patch:
        patch.setattr(terminal, "screen", Console(stderr=True, width=200))
        show()
    assert SHOWN in out.getvalue()
    assert set(out.getvalue()).isdisjoint(set(NAME) - set(SHOWN))


@pytest.mark.parametrize("name", [NAME, "$x$", "a$b$c_$", "_private", "<script>alert(1)</script>"])
@pytest.mark.parametrize("width", [10.0, 3.4])
def test_figures_show_names_as_they_are(tmp_path, name, width):
    t = torch.linspace(0.0, 1.0, 5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(rcParams, "svg.fonttype", "none")  # text stays text
        performance_profiles(t, {name: (t, t, t), "other": (t, t, t)}, tmp_path / "profiles.svg", name, width)
        deaths_chart({name: {"battery_valid": 3}, "b": {"battery_valid": 4}}, tmp_path / "deaths.svg")
    escaped = escape(visible(name), quote=False)
    pictures = list(tmp_path.iterdir())
    assert len(pictures) == 2
    for path in pictures:
        assert escaped in path.read_text()


def test_frames_show_names_as_they_are():
    pictures = []
    for text in (NAME, SHOWN):
        picture = Image.new("RGB", (600, 30))
        Pen(ImageDraw.Draw(picture), None, 1.0).text((2, 2), text, 12.0, "white")
        pictures.append(picture.tobytes())
    assert pictures[0] == pictures[1]
