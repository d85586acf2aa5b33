"""``bsk-torch view`` and ``bsk-torch export``: episodes in the browser, and as files."""

from __future__ import annotations

import re
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from bsk_torch.cli.film import FILMS
from bsk_torch.cli.film import film as write_film
from bsk_torch.cli.names import PRETRAINED
from bsk_torch.cli.planned import named_actor
from bsk_torch.cli.shared import check_writable, environment_options, extra
from bsk_torch.cli.terminal import echo, fail, working
from bsk_torch.files import write_file
from bsk_torch.presets import PRESETS
from bsk_torch.sim.arguments.values import nearest

FILES = (".html", ".bskview", ".czml")
"""What the names of exported recordings end with."""


def view(
    what: str,
    policy: str | None,
    seed: int,
    until: float | None,
    branch: list[str] | None,
    out: Path | None,
    host: str,
    port: int,
    browser: bool,
    plan: list[str] | None,
    threads: int,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Show an episode in the browser; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    if out is not None:
        _check_name(out, FILES)
    source = _source(what, policy, seed, until, branch, plan, environment_options(backend, device, time_limit))
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
        if browser and not webbrowser.open(_forwarding(server.url, Path(private))):
            echo("no browser was found; open the address in one")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            echo("stopped")
        finally:
            server.server_close()


def _forwarding(url: str, folder: Path) -> str:
    """Return the address of a private page that leads to ``url``: all users of a machine see the arguments of its programs."""
    page = folder / "open.html"
    write_file(page, f'<!doctype html><meta http-equiv="refresh" content="0; url={url}"><a href="{url}">the viewer</a>\n')
    return page.as_uri()


def export(
    what: str,
    out: Path,
    policy: str | None,
    seed: int,
    until: float | None,
    branch: list[str] | None,
    plan: list[str] | None,
    threads: int,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Write an episode to a file; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    _check_name(out, (*FILES, *FILMS))
    if out.suffix in FILMS:
        if what.endswith(".bskview") or branch:
            fail(f"--out {str(out)!r}: films show a preset or a run without branches; recordings become {', '.join(FILES)}")
        name, preset = _named(what, policy)
        write_film(name, preset, seed, out, until, None, 5.0, 480, plan, threads, backend, device, time_limit)
        return
    _write(_source(what, policy, seed, until, branch, plan, environment_options(backend, device, time_limit)), out)


def _check_name(out: Path, known: Sequence[str]) -> None:
    if out.suffix not in known:
        fail(f"--out {str(out)!r} must end with one of {', '.join(known)}; {nearest(out.suffix, known)}")
    check_writable(out)


def _named(what: str, policy: str | None) -> tuple[str, str | None]:
    """Policy and preset that the argument and ``--policy`` name; ends the program if there are none."""
    if what in PRESETS:
        return policy or PRETRAINED, what
    if policy is not None:
        fail(f"{what!r} is not a preset, for which --policy {policy} could fly; {nearest(what, PRESETS)}")
    return what, None


def _source(
    what: str,
    policy: str | None,
    seed: int,
    until: float | None,
    branch: list[str] | None,
    plan: list[str] | None,
    options: dict[str, object],
) -> object:
    """The flights to show: a recording, or flights with other futures."""
    recordings = extra("bsk_torch.recording.recording", "viz")
    if what.endswith(recordings.SUFFIX):
        if policy is not None or branch:
            fail(f"{what!r} is a recording, in which nothing flies any more; --policy and --branch are for presets and runs")
        try:
            return recordings.load(what)
        except ValueError as error:
            fail(str(error))
    pairs = [_branch(text) for text in branch or ()]
    name, preset = _named(what, policy)
    named = named_actor(name, preset, plan or ())
    env = named.environment(1, options)
    actor = named.actor(env, str(options["device"]))
    futures = extra("bsk_torch.viewer.futures", "viz").Futures(env, actor, preset=named.preset, label=named.label, until=until)
    with working("flying the episode"):
        futures.episode(seed)
    for decision, action in pairs:
        with working(f"flying another future from decision {decision}"):
            try:
                futures.branch(0, decision, action)
            except (IndexError, ValueError) as error:
                fail(f"--branch {decision}:{action}: {error.args[0]}")
    return futures


def _branch(text: str) -> tuple[int, int]:
    """Decision and action of ``--branch``; ends the program for other texts."""
    if not re.fullmatch(r"\d+:\d+", text):
        fail(f"--branch {text!r} must be DECISION:ACTION, two numbers such as 12:1")
    decision, action = text.split(":")
    return int(decision), int(action)


def _write(source: object, out: Path) -> None:
    """Write flights in the form that the name of the file asks for."""
    recordings = extra("bsk_torch.recording.recording")
    recording = source if isinstance(source, recordings.Recording) else source.recording()  # type: ignore[attr-defined]
    if out.suffix == ".html":
        content: bytes | str = recording.html()
    elif out.suffix == ".czml":
        try:
            content = extra("bsk_torch.viewer.czml").czml(recording)
        except ValueError as error:
            fail(str(error))
    else:
        content = recording.encode()
    write_file(out, content)
    tracks = [f"{track.label}: return {track.total:.3f}, {track.duration:,.0f} s" for track in recording.tracks]
    echo("\n".join([f"{out}: {out.stat().st_size / 1e6:.2f} MB", *tracks]))
