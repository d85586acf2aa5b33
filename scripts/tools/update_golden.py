"""Write the golden sources: the C++ of the tick of each preset's satellite types, which a test compares with the present one.

    python scripts/tools/update_golden.py                   update tests/codegen/golden
    python scripts/tools/update_golden.py --folder folder   write somewhere else

Read the difference before it is committed. Equal sources are written once, under the name of the first preset that has them;
presets.json says which files a preset uses. Satellites of one episode run in lockstep. The text depends neither on the machine
nor on the number of environments.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import bsk_torch
from bsk_torch.codegen import build, cpp
from bsk_torch.codegen.passes import lower
from bsk_torch.presets import PRESETS

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "tests/codegen/golden"
TABLE = "presets.json"


def tick_sources(preset: str) -> Iterator[str]:
    """The C++ of the ticks of a preset's satellite types."""
    env = bsk_torch.make(preset, num_envs=2, backend="eager")
    for simulator in env.fleet.simulators if hasattr(env, "fleet") else [env.simulator]:
        loop = simulator.tick.trace()
        yield cpp.source(lower(loop, lockstep=simulator.count > 1 and loop.stop is not None), build.INCLUDE)


def golden_files() -> dict[str, str]:
    """Contents of all golden files by name."""
    files: dict[str, str] = {}
    table: dict[str, list[str]] = {}
    for preset in PRESETS:
        table[preset] = []
        for k, source in enumerate(tick_sources(preset)):
            new = f"{preset}.cpp" if k == 0 else f"{preset}.{k}.cpp"
            name = next((name for name, known in files.items() if known == source), new)
            files[name] = source
            table[preset].append(name)
    return {**files, TABLE: json.dumps(table, indent=1) + "\n"}


def main() -> None:
    """Write what has changed, and remove what no preset uses."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where files are written (default: tests/codegen/golden)")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    files = golden_files()
    old = {path.name: path.read_text() for path in folder.iterdir()}
    for name in old.keys() - files.keys():
        (folder / name).unlink()
    for name, content in files.items():
        (folder / name).write_text(content)
    changed = [name for name in files if old.get(name) != files[name]]
    print(f"{len(files)} files in {folder}; written or changed: {', '.join(changed) or 'none'}")


if __name__ == "__main__":
    main()
