"""Record the programs of ``tests/bsk_rl/programs.py`` as bsk_rl plays them on Basilisk.

Usage::

    python scripts/recorders/record_drop_in.py                 # tests/bsk_rl/data
    python scripts/recorders/record_drop_in.py --out FOLDER

Needs the extra ``basilisk`` and its support data.
"""

import argparse
import json
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[2] / "tests"

if __name__ == "__main__":
    sys.path.insert(0, str(TESTS / "bsk_rl"))
    import programs

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=TESTS / "bsk_rl" / "data", help="folder of the recordings")
    folder = parser.parse_args().out
    for name in programs.PROGRAMS:
        path = folder / f"{name}.json"
        path.write_text(json.dumps(programs.play(name, "bsk_rl")))
        print(path)
