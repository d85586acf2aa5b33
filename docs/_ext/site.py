"""What the site shows beyond plain Markdown: parts in comments, pages of programs, and links from names to the reference."""

from __future__ import annotations

import re
from functools import cache

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata

from docs._ext.public import modules

ONLY = re.compile(r"^<!-- site\n(.*?)\n-->$", re.MULTILINE | re.DOTALL)
"""A part of a page that only the site has, such as a toctree."""

PROGRAM = re.compile(r"\]\(((?:\.\./)*)(tutorials|\.\./examples)(?:/([\w/]+)\.py)?\)")
"""A link to a program, or to the folder of programs, which have pages on the site."""

OUTSIDE = {"CHANGELOG.md": "/changelog.md", "ARCHITECTURE.md": "/contributing/architecture.md"}
"""Pages of the site that include a file of the repository."""

POWER = re.compile(r"-?[\d.]+e[-+]?\d+")
"""A number with an exponent, which browsers break after the hyphen."""

FOLDERS = {"tutorials": "_tutorials", "../examples": "gallery"}


def read(app: Sphinx, page: str, source: list[str]) -> None:
    """Show the parts of a page for the site, and link programs to their pages."""
    source[0] = ONLY.sub(r"\1", source[0])
    for file, shown in OUTSIDE.items():
        source[0] = re.sub(rf"\]\((?:\.\./)+{file}\)", f"]({shown})", source[0])
    source[0] = PROGRAM.sub(lambda link: f"]({link[1]}{FOLDERS[link[2]]}/{link[3] or 'index'}.rst)", source[0])


@cache
def entries() -> dict[str, dict[str, str]]:
    """Return where names lead to: public ones, with their package or without it, and presets."""
    from bsk_torch.presets import PRESETS

    found = {}
    for name in (name for module in modules() for name in module.own if name.kind != "module"):
        target = {"refdomain": "py", "reftype": "obj", "reftarget": name.full}
        found |= {name.full: target, name.full.removeprefix("bsk_torch."): target}
    for module in modules():
        found[module.name] = {"refdomain": "py", "reftype": "mod", "reftarget": module.name}
    return found | {n: {"refdomain": "std", "reftype": "doc", "reftarget": f"/api/reference/preset.{n}"} for n in PRESETS}


def link(app: Sphinx, page: nodes.document) -> None:
    """Let names in code within a line lead to their entries."""
    name = app.env.docname
    if not str(app.env.doc2path(name)).endswith(".md"):
        return
    for code in list(page.findall(nodes.literal)):
        target = entries().get(code.astext())
        if target and not isinstance(code.parent, nodes.reference | nodes.title | addnodes.pending_xref):
            code.replace_self(addnodes.pending_xref("", code.deepcopy(), refdoc=name, refexplicit=True, refwarn=True, **target))


def keep_numbers_whole(app: Sphinx, page: nodes.document) -> None:
    """Mark the cells of tables that hold one number with an exponent, for site.css."""
    for cell in page.findall(nodes.entry):
        if POWER.fullmatch(cell.astext()):
            cell["classes"].append("number")


def setup(app: Sphinx) -> ExtensionMetadata:
    """Add the changes of pages."""
    app.connect("source-read", read)
    app.connect("doctree-read", link)
    app.connect("doctree-read", keep_numbers_whole)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
