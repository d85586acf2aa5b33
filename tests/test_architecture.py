"""The map of the architecture is short, and what it names exists."""

import re
from pathlib import Path

from bsk_torch.env import base, constellation, satellite_group, tasking
from bsk_torch.env.assembly import fleets as build
from bsk_torch.sim import fleet, schedule, simulator

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "ARCHITECTURE.md").read_text()
NAMES = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", TEXT, flags=re.DOTALL))
PLACES = [ROOT, ROOT / "bsk_torch", *(ROOT / "bsk_torch" / name for name in ("sim", "env", "codegen"))]
OWNERS = (
    base.Tasking,
    tasking.SatelliteTasking,
    constellation.ConstellationTasking,
    build.FleetBuilder,
    satellite_group.SatelliteGroup,
)


def test_it_is_short_and_names_paths_that_exist_and_every_package():
    assert len(TEXT.splitlines()) <= 130
    paths = [name for name in NAMES if re.fullmatch(r"[\w./]+(\.(py|md|toml)|/)", name) and not name.startswith(".")]
    paths += re.findall(r"\(((?:sim|env)/[\w./]+\.py)", TEXT)
    assert len(paths) > 60
    missing = [path for path in paths if not any((place / path).exists() for place in PLACES)]
    assert not missing
    packages = {path.name for path in (ROOT / "bsk_torch").iterdir() if (path / "__init__.py").is_file()}
    packages |= {f"sim/{path.name}" for path in (ROOT / "bsk_torch" / "sim").iterdir() if (path / "__init__.py").is_file()}
    named = {name.strip("/").removeprefix("bsk_torch/") for name in NAMES if name.endswith("/")}
    named |= {f"sim/{name}" for name in named}
    assert not packages - named


def test_every_method_exists():
    owners = {owner.__name__: owner for owner in (*OWNERS, fleet.Fleet, simulator.Simulator)}
    found = [name.split(".") for name in NAMES if re.fullmatch(r"[A-Z]\w+\.\w+", name)]
    assert len(found) >= 8
    for owner, method in found:
        if owner in owners:
            assert hasattr(owners[owner], method), (owner, method)
    assert schedule.SCHEDULE
