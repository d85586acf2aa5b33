"""``bsk-torch view`` and ``bsk-torch export``: episodes in the browser, and as files."""

from __future__ import annotations

import re
import webbrowser
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from bsk_torch._listed import LISTED
from bsk_torch.cli.declaration import EnvironmentOptions, Plan, Seed, Trust, Until, flag
from bsk_torch.cli.film import FILMS
from bsk_torch.cli.film import film as write_film
from bsk_torch.cli.names import PRETRAINED, is_preset
from bsk_torch.cli.shared import check_file, extra
from bsk_torch.cli.terminal import echo, fail, refusing, working
from bsk_torch.files import write_file
from bsk_torch.sim.names import nearest

FILES = (".html", ".bskview", ".czml", ".oem", ".csv", ".json")
"""What the names of exported recordings end with."""

What = Annotated[str, typer.Argument(help="Preset, run folder, or recording (.bskview).", show_default=False)]
WithPolicy = Annotated[
    str | None,
    flag(
        "NAME",
        "Policy of a preset: 'pretrained' (default), a baseline, a run folder, a file or function of any library, or a planner.",
        "--policy",
    ),
]
Branches = Annotated[
    list[str] | None, flag("DECISION:ACTION", "Another future: take this action at that decision; repeatable.", "--branch")
]


def view(
    what: What,
    policy: WithPolicy = None,
    seed: Seed = 0,
    until: Until = None,
    branch: Branches = None,
    out: Annotated[
        Path | None, flag("FILE", "Write a file (.html, .bskview, .czml, .oem, .csv, .json) instead of starting a server.")
    ] = None,
    host: Annotated[str, flag("NAME", "Address of the server; others need a token.")] = "127.0.0.1",
    port: Annotated[int, flag("N", "Port of the server, or the next free one.", min=1, max=65535)] = 8765,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
    plan: Plan = None,
    trust: Trust = False,
    *,
    options: EnvironmentOptions,
) -> None:
    """Show an episode in the browser: a preset, a run or a recording.

    The page of a server also shows the value of every action at a decision, and flies other futures from there. With --out, one
    file plays without a server.

    Examples:
        bsk-torch view NadirScan-v1
        bsk-torch view Constellation-v1 --until 1200 --out team.html
        bsk-torch view NadirScan-v1 --policy rule --branch 12:1 --out futures.html
        bsk-torch view runs/scan
        bsk-torch view flight.bskview
    """
    if out is not None:
        check_file("--out", out, FILES)
    source = _source(what, policy, seed, until, branch, plan, options, trust)
    if out is not None:
        _write(source, out)
        return
    try:
        server = extra("bsk_torch.viewer.server").serve(source, host, port)
    except OSError as error:
        fail(f"--host {host} --port {port}: {error}")
    if server.port != port:
        echo(f"port {port} is in use; this is port {server.port}")
    echo(f"{server.url}\nstop with Ctrl-C")
    with TemporaryDirectory(prefix="bsk_torch-") as private:
        # a private page that leads there: all users of a machine see the arguments of its programs
        page, url = Path(private) / "open.html", server.url
        write_file(page, f'<!doctype html><meta http-equiv="refresh" content="0; url={url}"><a href="{url}">the viewer</a>\n')
        if browser and not webbrowser.open(page.as_uri()):
            echo("no browser was found; open the address in one")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            echo("stopped")
        finally:
            server.server_close()


def export(
    what: What,
    out: Annotated[
        Path, flag("FILE", "A page (.html), recording (.bskview), CZML, OEM, schedule (.csv, .json) or film (.mp4, .gif, .webp).")
    ],
    policy: WithPolicy = None,
    seed: Seed = 0,
    until: Until = None,
    branch: Branches = None,
    plan: Plan = None,
    trust: Trust = False,
    *,
    options: EnvironmentOptions,
) -> None:
    """Write an episode of a preset, a run or a recording to a file.

    Examples:
        bsk-torch export NadirScan-v1 --out flight.html
        bsk-torch export flight.bskview --out flight.czml
        bsk-torch export runs/scan --seed 7 --out flight.mp4
    """
    check_file("--out", out, (*FILES, *FILMS))
    if out.suffix in FILMS:
        if what.endswith(".bskview") or branch:
            fail(f"--out {str(out)!r}: films show a preset or a run without branches; recordings become {', '.join(FILES)}")
        name, preset = _named(what, policy)
        write_film(name, preset, seed, out, until, plan=plan, trust=trust, options=options)
        return
    _write(_source(what, policy, seed, until, branch, plan, options, trust), out)


def _named(what: str, policy: str | None) -> tuple[str, str | None]:
    """Policy and preset that the argument and ``--policy`` name; ends the program if there are none."""
    if is_preset(what):
        return policy or PRETRAINED, what
    if policy is not None:
        fail(f"{what!r} is not a preset, for which --policy {policy} could fly; {nearest(what, LISTED)}")
    return what, None


def _source(
    what: str,
    policy: str | None,
    seed: int,
    until: float | None,
    branch: list[str] | None,
    plan: list[str] | None,
    options: dict[str, object],
    trust: bool,
) -> object:
    """The flights to show: a recording, or flights with other futures."""
    from bsk_torch.cli.policies import named_actor

    recordings = extra("bsk_torch.recording.recording", "viz")
    if what.endswith(recordings.SUFFIX):
        if policy is not None or branch:
            fail(f"{what!r} is a recording, in which nothing flies any more; --policy and --branch are for presets and runs")
        with refusing():
            return recordings.load(what)
    pairs = [_branch(text) for text in branch or ()]
    name, preset = _named(what, policy)
    named = named_actor(name, preset, plan, trust)
    env = named.environment(1, options)
    actor = named.actor(env)
    futures = extra("bsk_torch.viewer.futures", "viz").Futures(env, actor, preset=named.preset, label=named.label, until=until)
    with working("flying the episode"):
        futures.episode(seed)
    for decision, action in pairs:
        why = f"--branch {decision}:{action}: "
        with working(f"flying another future from decision {decision}"), refusing(IndexError, ValueError, why=why):
            futures.branch(0, decision, action)
    return futures


def _branch(text: str) -> tuple[int, int]:
    """Decision and action of ``--branch``; ends the program for other texts."""
    if not re.fullmatch(r"\d+:\d+", text):
        fail(f"--branch {text!r} must be DECISION:ACTION, two numbers such as 12:1")
    decision, action = text.split(":")
    return int(decision), int(action)


def _write(source: object, out: Path) -> None:
    recordings = extra("bsk_torch.recording.recording")
    recording = source if isinstance(source, recordings.Recording) else source.recording()  # type: ignore[attr-defined]
    if out.suffix == ".html":
        content: bytes | str = recording.html()
    elif out.suffix in (".czml", ".oem"):
        with refusing():
            content = getattr(extra(f"bsk_torch.viewer.{out.suffix[1:]}"), out.suffix[1:])(recording)
    elif out.suffix in (".csv", ".json"):
        content = extra("bsk_torch.viewer.schedule").schedule(recording, out.suffix[1:])
    else:
        content = recording.encode()
    write_file(out, content)
    tracks = [f"{track.label}: return {track.total:.3f}, {track.duration:,.0f} s" for track in recording.tracks]
    echo("\n".join([f"{out}: {out.stat().st_size / 1e6:.2f} MB", *tracks]))
