"""Make the table of the orbits of AEOS-Bench's test set, from the file of the benchmark's repository.

    python scripts/tools/make_aeos_orbits.py orbits.zip

``data/orbits.zip`` of https://github.com/buaa-colalab/AEOSBench (Apache-2.0) has a JSON file for each of 4,994 orbits, most of
them of Starlink satellites. The table has them in the order of their ids, as whole numbers of their last digits, so that none is
rounded. Orbits through the Earth are left out: one of the 4,994 has a perigee of 880 km from its center.
"""

from __future__ import annotations

import argparse
import io
import json
import zipfile
from pathlib import Path

import numpy as np

from bsk_torch.files import write_file
from bsk_torch.tasks.aeos_bench.files import EARTH_RADIUS
from bsk_torch.tasks.aeos_bench.generator import DIGITS, ORBIT_FIELDS

FILE = Path(__file__).resolve().parents[2] / "bsk_torch/tasks/aeos_bench/tables/aeos_orbits.npz"


def main() -> None:
    """Read the orbits and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archive", type=Path, help="orbits.zip of the benchmark")
    parser.add_argument("--out", type=Path, default=FILE, help="file to write (default: %(default)s)")
    options = parser.parse_args()
    with zipfile.ZipFile(options.archive) as archive:
        orbits = [json.loads(archive.read(name)) for name in archive.namelist() if name.endswith(".json")]
    orbits = [orbit for orbit in orbits if orbit["semi_major_axis"] * (1.0 - orbit["eccentricity"]) > EARTH_RADIUS]
    orbits.sort(key=lambda orbit: orbit["id"])
    given = np.array([[orbit[name] for name in ORBIT_FIELDS] for orbit in orbits])
    whole = np.rint(given / DIGITS)
    if not np.allclose(whole * DIGITS, given, rtol=1e-14, atol=0.0):
        raise ValueError(f"{options.archive}: elements have more digits than {dict(zip(ORBIT_FIELDS, DIGITS, strict=True))}")
    content = io.BytesIO()
    np.savez_compressed(content, elements=whole.astype(np.int32))
    write_file(options.out, content.getvalue())
    print(f"{options.out}: {len(orbits)} orbits, {len(content.getvalue()):,} bytes")


if __name__ == "__main__":
    main()
