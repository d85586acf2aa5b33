"""Make `bsk_torch/astro/tables/nutation_iau2000a.csv`: the largest lunisolar terms of the nutation series IAU 2000A_R06.

    python scripts/tools/make_nutation.py

The series is that of the IERS Conventions (2010), tables 5.3a and 5.3b (IERS Technical Note 36), of which Skyfield ships a copy.
Terms with an amplitude of at least `SMALLEST` in longitude or obliquity are kept; what is left out is at most 1.5 mas between 1990
and 2060, which `tests/astro/test_earth_rotation.py` compares with the whole series in ERFA.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import skyfield

TABLE = Path(__file__).resolve().parents[2] / "bsk_torch/astro/tables/nutation_iau2000a.csv"
SMALLEST = 2000.0  # 0.1 microarcseconds
HEADER = "l,l',F,D,Om,psi_sin,psi_sin_T,psi_cos,eps_cos,eps_cos_T,eps_sin"


def main() -> None:
    """Write the table: five multiples of the fundamental arguments, and six amplitudes in 0.1 microarcseconds, a line."""
    series = np.load(Path(skyfield.__file__).parent / "data/nutation.npz")
    amplitudes = np.hstack([series["lunisolar_longitude_coefficients"], series["lunisolar_obliquity_coefficients"]])
    kept = np.abs(amplitudes).max(1) >= SMALLEST
    rows = np.hstack([series["nals_t"], amplitudes])[kept].astype(np.int64)
    np.savetxt(TABLE, rows, fmt="%d", delimiter=",", header=HEADER, comments="")


if __name__ == "__main__":
    main()
