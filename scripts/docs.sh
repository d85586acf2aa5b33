#!/usr/bin/env bash
# Makes .venv with the extra docs and builds the documentation into docs/_build/html, without a network and without warnings.
#   scripts/docs.sh            runs the tutorials, whose pictures and output become part of the pages
#   scripts/docs.sh --quick    shows tutorials without running them
# Environment variables:
#   BSK_TORCH_DOCS_URL         address that the site will have, for sitemap.xml; http://localhost:8000/ unless set
#   BSK_TORCH_DOCS_VERSIONS    folder of a site with several versions: the pages are also put there, as VERSION and as latest,
#                              with a page that lists all versions (docs/contributing/index.md)
# Look at the result with: python -m http.server --directory docs/_build/html
set -euo pipefail
case "${1:-}" in -h | --help) sed -n '2,/^set/s/^# \{0,1\}//p' "$0"; exit ;; esac
cd "$(dirname "$0")/.."
python="${PYTHON:-python3}"
export OMP_NUM_THREADS=1 BSK_TORCH_CACHE="${BSK_TORCH_CACHE:-$PWD/.venv/kernels}"
case "${1:-}" in
    "") ;;
    --quick) export BSK_TORCH_DOCS_QUICK=1 ;;
    *) echo "$1 is no option of scripts/docs.sh; there is --quick" >&2; exit 2 ;;
esac

[ -x .venv/bin/python ] || "$python" -m venv .venv
# torch first and by exact version: an open range may bring gigabytes of CUDA packages
.venv/bin/python -m pip install -q "torch==$(sed -n 's/^torch==//p' constraints.txt)"
.venv/bin/python -m pip install -q -c constraints.txt -e ".[tensorboard,viz,video,sb3,cities,docs]"
.venv/bin/python -m pip install -q --no-deps benchmarl==1.5.2  # a page of the reference; pip would take an older TorchRL with it

.venv/bin/python -m sphinx -b html -W --keep-going -q docs docs/_build/html
if [ -n "${BSK_TORCH_DOCS_VERSIONS:-}" ]; then
    .venv/bin/python scripts/tools/publish_docs.py docs/_build/html "$BSK_TORCH_DOCS_VERSIONS"
fi
echo "docs/_build/html/index.html"
