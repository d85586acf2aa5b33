"""Cross-references to other projects without a network: tables of names and pages become inventories for intersphinx.

A table is a file ``docs/inventories/PROJECT.txt``: the first line is the address of the project's site, every other line a role
(``py:class``), a name and its page, ``$`` standing for the name. Classes are also listed under the modules that define them,
because annotations name them so.
"""

from __future__ import annotations

from pathlib import Path

import sphobjinv


def read(table: Path) -> tuple[str, list[tuple[str, str, str]]]:
    """Return the address of a table's site, and its rows: role, name, page."""
    address, *lines = (line.strip() for line in table.read_text().splitlines() if line.strip() and not line.startswith("#"))
    rows = [line.split() for line in lines]
    return address, [(role, name, page) for role, name, page in rows]


def write(tables: Path, folder: Path) -> dict[str, tuple[str, str]]:
    """Write an inventory for each table into ``folder``; return intersphinx's setting."""
    folder.mkdir(parents=True, exist_ok=True)
    mapping = {}
    for table in sorted(tables.glob("*.txt")):
        address, rows = read(table)
        inventory = sphobjinv.Inventory()
        inventory.project, inventory.version = table.stem, "stable"
        for role, name, page in rows:
            domain, kind = role.split(":")
            entry = sphobjinv.DataObjStr(name=name, domain=domain, role=kind, priority="1", uri=page, dispname="-")
            inventory.objects.append(entry)
        path = folder / f"{table.stem}.inv"
        sphobjinv.writebytes(path, sphobjinv.compress(inventory.data_file(contract=True)))
        mapping[table.stem] = (address, str(path))
    return mapping
