"""Writes pages of the reference: one for each public module, class and preset from docstrings, and one of all commands."""

from __future__ import annotations

import builtins
import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.typing import ExtensionMetadata

from bsk_torch.presets import PRESETS
from docs._ext.listings import about, commands_in_full, options
from docs._ext.public import FIELD, Module, Name, modules, sections

EXTERNAL = {
    "argparse",
    "benchmarl",
    "collections",
    "contextlib",
    "datetime",
    "gymnasium",
    "logging",
    "matplotlib",
    "numpy",
    "pathlib",
    "pettingzoo",
    "ray",
    "stable_baselines3",
    "tensordict",
    "torch",
    "torchrl",
    "typing",
}
"""Packages whose names the tables in ``docs/inventories`` must have."""

FOLDER = "reference"
"""Folder of the pages within ``docs/api``; git ignores it."""

SHORT_VALUE = 60
"""Maximum number of characters of a displayed value."""

TABLED = 4
"""From so many members on, the page of a class begins with a table of them."""


def setup(app: Sphinx) -> ExtensionMetadata:
    """Write the pages when a build starts."""
    app.connect("builder-inited", lambda app: write(Path(app.srcdir) / "api" / FOLDER))
    app.connect("autodoc-process-docstring", prepare, priority=400)
    app.connect("missing-reference", inner)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def prepare(app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Leave out what NamedTuple says of its fields; keep napoleon from taking words before a colon for the type of a property."""
    if lines and lines[0].startswith(FIELD):
        lines.clear()
    if lines and what in ("attribute", "data", "property"):
        lines.insert(0, "")


def inner(app: Sphinx, env: BuildEnvironment, node: addnodes.pending_xref, shown: nodes.TextElement) -> nodes.TextElement | None:
    """Show a name that has no page: one of the package's inside, or of an object that a docstring speaks of."""
    target = node.get("reftarget", "")
    external = target.partition(".")[0] in EXTERNAL or hasattr(builtins, target)
    return shown if node.get("refdomain") == "py" and not external else None


def describe_properties() -> None:
    """Give the functions behind properties their docstrings, which autodoc reads there; an ``@observable`` has only its own."""
    for module in modules():
        for name in module.of("class"):
            for value in vars(name.value).values():
                if isinstance(value, property) and value.fget is not None and not value.fget.__doc__:
                    value.fget.__doc__ = value.__doc__


def write(folder: Path) -> None:
    """Write all pages; those that have not changed keep their time, so that they are not read again."""
    describe_properties()
    folder.mkdir(exist_ok=True)
    pages = {"index.rst": index(), "commands.md": commands_in_full()}
    pages |= {f"preset.{name}.rst": preset_page(name, preset) for name, preset in PRESETS.items()}
    for section in sections().values():
        for module in section:
            pages[f"{module.name}.rst"] = module_page(module)
            pages |= {f"{name.full}.rst": class_page(name) for name in module.of("class")}
    for path in folder.iterdir():
        if path.name not in pages:
            path.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def index() -> str:
    """Return the page that lists the modules."""
    text = [title("Modules"), "Every public name of the package, from its docstrings.\n"]
    for section, group in sections().items():
        text += [title(section, "-"), listing([(f":doc:`{m.name} <{m.name}>`", m.summary) for m in group], "40 60")]
        text += [toctree([m.name for m in group])]
    return "\n".join(text)


def module_page(module: Module) -> str:
    """Return the page of a module."""
    text = [title(f"``{module.name}``"), f".. automodule:: {module.name}\n", f".. currentmodule:: {module.name}\n"]
    submodules = [(f":doc:`{n.value.__name__} <{n.value.__name__}>`", first_line(n.documentation)) for n in module.of("module")]
    tables = {
        "Modules": submodules,
        "Classes": [row(name) for name in module.of("class")],
        "Functions": [row(name) for name in module.of("function")],
        "Data": [row(name) for name in module.of("data")],
        "Elsewhere": [row(name, name.full) for name in module.others],
    }
    for heading, rows in tables.items():
        if rows:
            text += [f".. rubric:: {heading}\n", listing(rows)]
    for name in module.of("function"):
        text += [f".. autofunction:: {name.full}\n"]
    text += [data(name) for name in module.of("data")]
    return "\n".join(text)


def preset_page(name: str, preset: Any) -> str:
    """Return the page of a preset: its options, then the decision process that its module states."""
    rows = [(f"``{option} = {default}``", meaning) for option, default, meaning in options(preset)]
    text = [
        title(f"``{name}``"),
        f"{about(name)[0].upper()}{about(name)[1:]}.\n".replace("`", "``"),
        f"``bsk_torch.make({name!r}, num_envs=..., **options)``\n",
    ]
    text += [".. rubric:: Options\n", listing(rows, "40 60")] if rows else []
    return "\n".join([*text, f".. automodule:: {preset.__module__}\n   :no-index:\n"])


def class_page(name: Name) -> str:
    """Return the page of a class: a table of its members where there are some, then everything in full.

    It is no entry of the menu, which would be long and slow to build; the page of its module leads there.
    """
    text = [":orphan:\n", title(f"``{name.name}``"), f"Part of :doc:`{name.module}`.\n", f".. currentmodule:: {name.module}\n"]
    if len(name.members) >= TABLED:
        rows = [
            (f":py:obj:`{m} <{name.full}.{m}>`", first_line(inspect.getdoc(inspect.getattr_static(name.value, m)) or ""))
            for m in name.members
        ]
        text += [f".. rubric:: Members of {name.name}\n", listing(rows)]
    text += [f".. autoclass:: {name.full}\n   :members:\n   :show-inheritance:\n"]
    return "\n".join(text)


def row(name: Name, shown: str = "") -> tuple[str, str]:
    """Return link and first sentence of a name."""
    return f":py:obj:`{shown or name.name} <{name.full}>`", first_line(name.documentation)


def first_line(documentation: str) -> str:
    """Return the first sentence of a docstring."""
    text = documentation.partition("\n\n")[0].replace("\n", " ")
    sentence = text.partition(". ")[0]
    sentence = text if sentence.count("``") % 2 else sentence  # the point may lie in a literal
    return sentence.rstrip(".") + "." if text else ""


def data(name: Name) -> str:
    """Return the entry of a constant or a table, whose value is shown where it is short."""
    value = repr(name.value)
    keys = [f"``{key}``" for key in name.value] if isinstance(name.value, Mapping) else []
    shown = [f"   :value: {value}"] if len(value) <= SHORT_VALUE else []
    parts = [f".. py:data:: {name.name}", *shown, "", *(f"   {line}" for line in name.documentation.splitlines()), ""]
    return "\n".join([*parts, f"   Keys: {', '.join(keys)}\n" if keys else ""])


def title(text: str, line: str = "=") -> str:
    """Return a heading."""
    return f"{text}\n{line * len(text)}\n"


def listing(rows: list[tuple[str, str]], widths: str = "30 70") -> str:
    """Return a table of two columns, with their shares of the width."""
    lines = [".. list-table::", f"   :widths: {widths}", "   :class: summary", ""]
    for left, right in rows:
        lines += [f"   * - {left}", f"     - {right}"]
    return "\n".join([*lines, ""])


def toctree(pages: list[str]) -> str:
    """Return a hidden toctree."""
    return "\n".join([".. toctree::", "   :hidden:", "", *(f"   {page}" for page in pages), ""])
