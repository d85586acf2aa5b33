#!/usr/bin/env bash
# Tries the newest torch, TorchRL and tensordict that install together, with the newest versions of all other packages: makes
# .venv-newest (5 GB where pip's newest torch is a CUDA build), runs tests that use all of them, and prints one row for
# docs/start/installation.md.
#   scripts/tools/try_newest.sh [pytest arguments instead of the chosen tests]
# Environment variables:
#   TORCH   version of torch instead of the newest, such as that of a CPU build: 2.13.0+cpu
#   VENV    folder of the virtual environment instead of .venv-newest
set -euo pipefail
case "${1:-}" in -h | --help) sed -n '2,/^set/s/^# \{0,1\}//p' "$0"; exit ;; esac
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
venv=${VENV:-$PWD/.venv-newest}
[ -x "$venv/bin/python" ] || "${PYTHON:-python3}" -m venv "$venv"
"$venv/bin/python" -m pip install -q --upgrade "torch${TORCH:+==$TORCH}" torchrl tensordict
"$venv/bin/python" -m pip install -q -e ".[viz,sb3,test]"
chosen=(tests/codegen/test_kernel.py tests/basilisk tests/env/test_contract.py tests/env/test_state.py tests/wrappers tests/rl/test_training.py)
[ $# -eq 0 ] || chosen=("$@")
export OMP_NUM_THREADS=1 BSK_TORCH_CACHE="${BSK_TORCH_CACHE:-$venv/kernels}"
status=0
"$venv/bin/python" -m pytest "${chosen[@]}" | tee "$venv/tests.log" || status=$?
versions=$("$venv/bin/python" -c "
from importlib.metadata import version
print(' | '.join(version(name) for name in ('torch', 'torchrl', 'tensordict')))")
echo "| $(date +%F) | $versions | $(tail -1 "$venv/tests.log") |"
exit $status
