"""Make `bsk_torch/viewer/page/vendor/three.js`: the parts of three.js that the viewer imports, as one minified module.

    python scripts/tools/make_three.py

It needs npm and its registry. Names come from the imports of the viewer's modules; esbuild leaves out what none of them needs.
three.js has the MIT license, which is written next to the module as LICENSE.three.txt.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "bsk_torch" / "viewer" / "page"

VERSIONS = {"three": "0.187.0", "esbuild": "0.28.2"}


def imported(page: Path = PAGE) -> list[str]:
    """Names that the modules of a folder import from three.js."""
    lists = [names for path in page.glob("*.js") for names in re.findall(r'import \{([^}]*)\} from "three"', path.read_text())]
    return sorted({name.strip() for names in lists for name in names.split(",") if name.strip()})


def main() -> None:
    """Download both packages into a temporary folder, bundle, and write the module and the license."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=PAGE / "vendor", metavar="FOLDER")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        packages = [f"{name}@{version}" for name, version in VERSIONS.items()]
        subprocess.run(["npm", "install", "--silent", "--no-audit", "--no-fund", *packages], cwd=place, check=True)
        (place / "entry.js").write_text(f'export {{ {", ".join(imported())} }} from "three";\n')
        banner = f"/* three.js {VERSIONS['three']}, MIT license, see LICENSE.three.txt; made by scripts/tools/make_three.py */"
        flags = ["--bundle", "--minify", "--format=esm", "--legal-comments=none", f"--banner:js={banner}"]
        subprocess.run(["npx", "esbuild", "entry.js", *flags, "--outfile=three.js", "--log-level=warning"], cwd=place, check=True)
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "three.js").write_bytes((place / "three.js").read_bytes())
        (options.out / "LICENSE.three.txt").write_bytes((place / "node_modules" / "three" / "LICENSE").read_bytes())
    print(f"{options.out / 'three.js'}: {len(imported())} names, {(options.out / 'three.js').stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
