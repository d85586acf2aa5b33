#!/usr/bin/env bash
# Makes .venv, installs bsk_torch with what the tests need, and runs linters, type checker and tests.
#   scripts/test.sh [pytest arguments]
# Without arguments these are all tests but those of the night. The tests of the documentation (marker pages: blocks of the pages,
# tutorials, the site) are left out where pages, examples, signatures and docstrings are those with which they last passed, which
# tests/docs/stamp.json notes; where one of these has changed, or git cannot say, they run. Blocks of the README always run.
#   scripts/test.sh --docs   only the tests of the documentation; then notes that they have passed
#   scripts/test.sh --all    then also the tests that need Ray, and those that need Basilisk or RLlib, which pin other packages: in
#                            .venv-basilisk and .venv-rllib. Basilisk downloads its support data unless BSK_SUPPORT_DATA_CACHE
#                            names a folder with them (see tests/basilisk/recorders/recording.py). No test is skipped for a
#                            missing package.
#   scripts/test.sh --basilisk, --rllib    only one of these two
#   scripts/test.sh --browser [pytest arguments]    only the tests of pages, reports and the viewer in Chromium, which is
#                            installed with apt-get where it is missing; part of --all
#   scripts/test.sh --nightly [pytest arguments]    only the tests that take long, of the marker nightly, and those of the
#                            documentation, so that a page which breaks by a change inside of a function is found here; then, where
#                            --basilisk or --all has made .venv-basilisk, 40 random problems in bsk_rl on Basilisk and here
set -euo pipefail
case "${1:-}" in -h | --help) sed -n '2,/^set/s/^# \{0,1\}//p' "$0"; exit ;; esac
cd "$(dirname "$0")/.."
python="${PYTHON:-python3}"
# processes that tests start find the package as bytecode, with which they import it in a quarter of the time
unset PYTHONDONTWRITEBYTECODE
# one cache of kernels for all tests, and no threads that fight over the cores
export OMP_NUM_THREADS=1 BSK_TORCH_CACHE="${BSK_TORCH_CACHE:-$PWD/.venv/kernels}"

make_venv() {  # folder; torch first and by exact version: an open range may bring gigabytes of CUDA packages
    [ -x "$1/bin/python" ] || "$python" -m venv "$1"
    "$1/bin/python" -m pip install -q "torch==$(sed -n 's/^torch==//p' constraints.txt)"
}

test_basilisk() {
    make_venv .venv-basilisk
    .venv-basilisk/bin/python -m pip install -q -e ".[basilisk,cities]" pyshp shapely
    # bsk-rl pins an old pytest, which it does not need to run
    .venv-basilisk/bin/python -m pip install -q --no-deps "pytest==$(sed -n 's/^pytest==//p' constraints.txt)" pytest-xdist execnet
    # only files with such a test: others import packages that are not installed here
    local files
    mapfile -t files < <(grep -rlE 'mark\.(basilisk|coastlines)\b' tests --include='*.py')
    BSK_TORCH_STRICT_TESTS=1 .venv-basilisk/bin/python -m pytest -m "basilisk or coastlines" "${files[@]}"
}

fly_random_problems() {  # other ones every day, of the environments of this package and of the package that is bsk_rl
    local first=$(($(date +%s) / 86400 * 20))
    for library in bsk_torch bsk_torch.bsk_rl; do
        .venv-basilisk/bin/python scripts/validation/differential.py --library "$library" --seeds "$first:$((first + 20))"
    done
}

test_rllib() {
    make_venv .venv-rllib
    .venv-rllib/bin/python -m pip install -q -e . "ray[rllib]==2.60.0" "pytest==$(sed -n 's/^pytest==//p' constraints.txt)"
    BSK_TORCH_STRICT_TESTS=1 .venv-rllib/bin/python -m pytest -m rllib tests/test_clients.py
}

install_chromium() {
    command -v chromium > /dev/null && return
    echo "installing Chromium, which the tests of the marker browser need: apt-get install chromium"
    root=""
    [ "$(id -u)" = 0 ] || root=sudo
    $root apt-get update -qq
    $root apt-get install -y -qq chromium
}

test_browser() {
    install_chromium
    BSK_TORCH_STRICT_TESTS=1 .venv/bin/python -m pytest -m browser tests/docs tests/viz tests/viewer tests/test_scripts.py "$@"
}

case "${1:-}" in
    --basilisk) test_basilisk; exit ;;
    --rllib) test_rllib; exit ;;
esac
make_venv .venv
extras=tensorboard,viz,video,sb3,cities,minari,docs,dev
case "${1:-}" in --all | --nightly) extras=$extras,ray ;; esac
.venv/bin/python -m pip install -q -c constraints.txt -e ".[$extras]"
# a client that no one here wrote; pip would take an older TorchRL with it
.venv/bin/python -m pip install -q --no-deps benchmarl==1.5.2
# validates CZML; pip would take an older python-dateutil with it
.venv/bin/python -m pip install -q --no-deps czml3==4.0.0
if [ "${1:-}" = --browser ]; then
    test_browser "${@:2}"
    exit
fi
.venv/bin/ruff check .
.venv/bin/ruff format --check .
.venv/bin/python scripts/tools/check_prose.py
.venv/bin/mypy
.venv/bin/lint-imports
.venv/bin/python -W error -c "import bsk_torch"
if [ "${1:-}" = --nightly ]; then
    .venv/bin/python -m pytest -m "nightly or pages" "${@:2}"
    if [ -x .venv-basilisk/bin/python ]; then fly_random_problems; fi
    exit
fi
# files in their order, each by one worker (tests/conftest.py): by number of tests, the longest would come last
parallel=(-n 2 --dist loadgroup --no-loadscope-reorder)
if [ "${1:-}" = --docs ]; then
    .venv/bin/python -m pytest "${parallel[@]}" -m pages
    exec .venv/bin/python scripts/tools/docs_stamp.py --write
fi
if [ "${1:-}" = --all ]; then
    .venv/bin/python -m pytest "${parallel[@]}"
    test_browser
    test_basilisk
    test_rllib
    exit
fi
if [ $# -gt 0 ]; then exec .venv/bin/python -m pytest "$@"; fi
if .venv/bin/python scripts/tools/docs_stamp.py; then
    exec .venv/bin/python -m pytest "${parallel[@]}" -m "not nightly and not browser and not pages"
fi
exec .venv/bin/python -m pytest "${parallel[@]}"
