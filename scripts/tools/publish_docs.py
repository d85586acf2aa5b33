"""Puts built pages into the folder of a site with several versions, as VERSION and as latest, and lists the versions there."""

from __future__ import annotations

import argparse
import shutil
from html import escape
from pathlib import Path

import bsk_torch

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>bsk_torch: versions</title>
<style>:root {{ color-scheme: light dark }} body {{ font: 1.1rem system-ui; margin: 2rem auto; max-width: 40rem }}</style>
<h1>bsk_torch</h1>
<ul>
{items}
</ul>
</html>
"""


def main(pages: Path, site: Path) -> None:
    """Copy ``pages`` to ``site`` and renew its list."""
    for name in (bsk_torch.__version__, "latest"):
        shutil.rmtree(site / name, ignore_errors=True)
        shutil.copytree(pages, site / name)
    names = sorted((path.parent.name for path in site.glob("*/index.html")), key=order, reverse=True)
    items = "\n".join(f'<li><a href="{escape(name)}/index.html">{escape(name)}</a></li>' for name in names)
    (site / "index.html").write_text(PAGE.format(items=items))


def order(name: str) -> tuple[bool, list[int]]:
    """Return what sorts versions: latest above all, numbers by value."""
    return name == "latest", [int(part) for part in name.split(".") if part.isdigit()]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", type=Path, help="folder of the built pages")
    parser.add_argument("site", type=Path, help="folder of the site")
    given = parser.parse_args()
    if not (given.pages / "index.html").is_file():
        parser.error(f"{str(given.pages)!r} has no index.html; build the pages first: scripts/docs.sh")
    main(given.pages, given.site)
