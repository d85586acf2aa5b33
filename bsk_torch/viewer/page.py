"""The viewer as one HTML page, which needs no server, no network and no other file.

The folder ``page`` has its parts: modules, style, template, and three.js in ``page/vendor``. Modules import one another by names
such as ``viewer/timeline``; the page has a table of these names with the modules as base64 (an import map).
"""

from __future__ import annotations

import json
from base64 import b64encode
from hashlib import sha256
from html import escape
from importlib.resources import files
from string import Template

__all__ = ["build_page"]

THREE = "vendor/three.js"


def build_page(recording: bytes | None = None, live: str | None = None, title: str = "bsk_torch viewer") -> str:
    """Return the page as HTML.

    The page allows no scripts but its parts, and no requests but those to the server that it comes from.

    Args:
        recording: Content of a recording, from :meth:`bsk_torch.recording.recording.Recording.encode`; the page contains it.
        live: Address of a server that has the recording and computes other futures, such as ``/api``.
        title: Title of the window until the recording is loaded.

    Raises:
        ValueError: Without a recording and a server.
    """
    if recording is None and live is None:
        raise ValueError("recording=None and live=None leave nothing to show: give a recording, the address of a server, or both")
    template = _part("template.html")
    # see bsk_torch.viz.figures.world.land for their source
    coastlines = files("bsk_torch.viz.figures").joinpath("land_110m.geojson").read_text(encoding="utf-8")
    imports = _script_json({"imports": _modules()})
    return Template(template).substitute(
        policy=_policy(imports, template),
        title=escape(title),
        style=_part("style.css"),
        imports=imports,
        settings=_script_json({"live": live}),
        land=_script_json({"coordinates": json.loads(coastlines)["coordinates"]}),
        recording="" if recording is None else b64encode(recording).decode(),
    )


def _part(name: str) -> str:
    return files("bsk_torch.viewer").joinpath("page").joinpath(name).read_text(encoding="utf-8")


def _modules() -> dict[str, str]:
    """Every module by the name under which others import it, as a data URL."""
    folder = files("bsk_torch.viewer").joinpath("page")
    names = sorted(entry.name for entry in folder.iterdir() if entry.name.endswith(".js"))
    modules = {"three": _part(THREE)} | {f"viewer/{name.removesuffix('.js')}": _part(name) for name in names}
    return {name: f"data:text/javascript;base64,{b64encode(text.encode()).decode()}" for name, text in modules.items()}


def _script_json(value: object) -> str:
    """JSON that no text in it can end the script element."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


def _policy(imports: str, template: str) -> str:
    """Content security policy: of scripts in the page, only the table of names and the start, by their hashes."""
    start = template.partition('<script type="module">')[2].partition("</script>")[0]
    hashes = " ".join(f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'" for text in (imports, start))
    return (
        f"default-src 'none'; script-src {hashes} data:; style-src 'unsafe-inline'; img-src data: blob:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'"
    )
