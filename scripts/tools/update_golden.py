"""Write the golden sources: the C++ of the tick of each preset's satellite types, which a test compares with the present one.

    python scripts/tools/update_golden.py                           update tests/codegen/golden
    python scripts/tools/update_golden.py --folder folder --whole   write all sources somewhere else, to compare them

Read the difference before it is committed. The sources of the presets ``WHOLE`` are written in full; of the others, which mostly
repeat them, presets.json has the hashes. It also lists the sources of each preset. Equal sources count once, under the name of
the first preset that has them. Satellites of one episode run in lockstep. The text depends neither on the machine nor on the
number of environments.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Collection, Iterator
from pathlib import Path

import bsk_torch
from bsk_torch.codegen import build, cpp
from bsk_torch.codegen.passes import lower
from bsk_torch.presets import PRESETS

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "tests/codegen/golden"
TABLE = "presets.json"
WHOLE = ("AEOS-v1",)
"""Presets whose sources are written in full: an imager, with most components; a hash reveals changes of the others as well."""


def tick_sources(preset: str) -> Iterator[str]:
    """The C++ of the ticks of a preset's satellite types."""
    env = bsk_torch.make(preset, num_envs=2, backend="eager")
    for simulator in env.fleet.simulators if hasattr(env, "fleet") else [env.simulator]:
        loop = simulator.tick.trace()
        yield cpp.source(lower(loop, lockstep=simulator.count > 1 and loop.stop is not None), build.INCLUDE)


def all_sources() -> tuple[dict[str, str], dict[str, list[str]]]:
    """Sources by name, and the names of each preset's sources."""
    sources: dict[str, str] = {}
    names: dict[str, list[str]] = {}
    for preset in PRESETS:
        names[preset] = []
        for k, source in enumerate(tick_sources(preset)):
            new = f"{preset}.cpp" if k == 0 else f"{preset}.{k}.cpp"
            name = next((name for name, known in sources.items() if known == source), new)
            sources[name] = source
            names[preset].append(name)
    return sources, names


def golden_files(sources: dict[str, str], names: dict[str, list[str]], whole: Collection[str] = WHOLE) -> dict[str, str]:
    """Contents of the golden files by name: the sources of the presets ``whole``, and the table with the hashes of the others."""
    kept = {name for preset in whole for name in names[preset]}
    hashes = {name: hashlib.sha256(source.encode()).hexdigest() for name, source in sources.items() if name not in kept}
    table = json.dumps({"presets": names, "sha256": hashes}, indent=1) + "\n"
    return {name: source for name, source in sources.items() if name in kept} | {TABLE: table}


def main() -> None:
    """Write what has changed, and remove what no preset uses."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where files are written (default: tests/codegen/golden)")
    parser.add_argument("--whole", action="store_true", help="write the sources of all presets in full")
    options = parser.parse_args()
    folder = options.folder
    folder.mkdir(parents=True, exist_ok=True)
    files = golden_files(*all_sources(), whole=tuple(PRESETS) if options.whole else WHOLE)
    old = {path.name: path.read_text() for path in folder.iterdir()}
    for name in old.keys() - files.keys():
        (folder / name).unlink()
    for name, content in files.items():
        (folder / name).write_text(content)
    changed = [name for name in files if old.get(name) != files[name]]
    print(f"{len(files)} files in {folder}; written or changed: {', '.join(changed) or 'none'}")


if __name__ == "__main__":
    main()
