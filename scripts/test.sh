#!/usr/bin/env bash
# Makes .venv, installs bsk_torch with what the tests need, and runs linters, type checker and tests.
#   scripts/test.sh [pytest arguments]
set -euo pipefail
cd "$(dirname "$0")/.."
python="${PYTHON:-python3}"
[ -x .venv/bin/python ] || "$python" -m venv .venv
# torch first and by exact version: an open range may bring gigabytes of CUDA packages
.venv/bin/python -m pip install -q -c constraints.txt "torch==$(sed -n 's/^torch==//p' constraints.txt)"
.venv/bin/python -m pip install -q -c constraints.txt -e ".[train,tensorboard,viz,video,sb3,cities,dev]"
# a client that no one here wrote; pip would take an older TorchRL with it
.venv/bin/python -m pip install -q --no-deps benchmarl==1.5.2
# one cache of kernels for all tests, and no threads that fight over the cores
export OMP_NUM_THREADS=1 BSK_TORCH_CACHE="${BSK_TORCH_CACHE:-$PWD/.venv/kernels}"
.venv/bin/ruff check .
.venv/bin/ruff format --check .
.venv/bin/mypy
.venv/bin/lint-imports
.venv/bin/python -W error -c "import bsk_torch"
if [ $# -gt 0 ]; then exec .venv/bin/python -m pytest "$@"; fi
exec .venv/bin/python -m pytest -n 2 --dist loadgroup
