#!/usr/bin/env bash
# Makes .venv, installs bsk_torch with what the tests need, and runs linters, type checker and tests. Three levels:
#   scripts/test.sh              before each commit: linters, types, contracts, fast tests, a slow test of each promise of the README
#   scripts/test.sh --full       before a change lands: also all slower tests, documentation included
#   scripts/test.sh --nightly    what takes long, too, what needs Basilisk, Ray, RLlib or a browser, and the package without each of
#                                its rooms; writes tests/durations.json
#
#   scripts/test.sh [--full] [--shard 1/2] [pytest arguments]    only a part of the tests, which machines can share, or some tests:
#                                                                scripts/test.sh tests/sim -k orbit
#   scripts/test.sh --basilisk | --rllib | --browser             this part of the night alone
# The level of a test follows from tests/durations.json, and from the mark nightly. Nothing is installed again until pyproject.toml
# or constraints.txt change.
# Basilisk downloads its support data unless BSK_SUPPORT_DATA_CACHE names a folder with them (scripts/recorders/recording.py).
set -euo pipefail
case "${1:-}" in -h | --help) sed -n '2,/^set/s/^# \{0,1\}//p' "$0" | sed '$d'; exit ;; esac
cd "$(dirname "$0")/.."
python="${PYTHON:-python3}"
# processes that tests start find the package as bytecode, with which they import it in a quarter of the time
unset PYTHONDONTWRITEBYTECODE
# one cache of kernels for all tests, and no threads that fight over the cores
export OMP_NUM_THREADS=1 BSK_TORCH_CACHE="${BSK_TORCH_CACHE:-$PWD/.venv/kernels}"

install() {  # folder of the environment, then arguments of pip
    local folder=$1 wanted
    shift
    wanted=$(cat pyproject.toml constraints.txt <(echo "$PWD" "$@") | sha256sum)
    grep -qsF "$wanted" "$folder/installed" && return
    [ -x "$folder/bin/python" ] || "$python" -m venv "$folder"
    # torch first and by exact version: an open range may bring gigabytes of CUDA packages
    if "$folder/bin/python" -m pip install -q --retries 1 --no-compile "torch==$(pinned torch)" &&
        "$folder/bin/python" -m pip install -q --retries 1 --no-compile "$@"; then
        echo "$wanted" >> "$folder/installed"
    elif "$folder/bin/python" -c "import bsk_torch, pytest, torchrl" 2> /dev/null; then
        echo "test.sh: the installation failed, see above; testing with what $folder has" >&2
    else
        echo "test.sh: the installation failed, see above; without it, nothing can be tested" >&2
        exit 1
    fi
}

pinned() { sed -n "s/^$1==//p" constraints.txt; }

test_basilisk() {
    install .venv-basilisk -e ".[basilisk,cities]" pyshp shapely
    # bsk-rl pins an old pytest, which it does not need to run
    install .venv-basilisk --no-deps "pytest==$(pinned pytest)" pytest-xdist execnet
    # only files with such a test: others import packages that are not installed here
    local files
    mapfile -t files < <(grep -rlE 'mark\.(basilisk|coastlines)\b' tests --include='*.py')
    BSK_TORCH_STRICT_TESTS=1 .venv-basilisk/bin/python -m pytest --levels all -m "basilisk or coastlines" "${files[@]}"
}

fly_random_problems() {  # other ones every day, of the environments of this package and of the package that is bsk_rl
    local first=$(($(date +%s) / 86400 * 20))
    for library in bsk_torch bsk_torch.bsk_rl; do
        .venv-basilisk/bin/python scripts/validation/differential.py --library "$library" --seeds "$first:$((first + 20))"
    done
}

test_rllib() {
    install .venv-rllib -e . "ray[rllib]==2.60.0" "pytest==$(pinned pytest)"
    BSK_TORCH_STRICT_TESTS=1 .venv-rllib/bin/python -m pytest --levels all -m rllib tests/test_clients.py
}

test_browser() {
    if ! command -v chromium > /dev/null; then
        echo "installing Chromium, which the tests of the marker browser need: apt-get install chromium"
        local root=""
        [ "$(id -u)" = 0 ] || root=sudo
        $root apt-get update -qq
        $root apt-get install -y -qq chromium
    fi
    BSK_TORCH_STRICT_TESTS=1 .venv/bin/python -m pytest --levels all -m browser tests/docs tests/viz tests/viewer tests/test_scripts.py "$@"
}

install_extras() {  # level
    case $1 in
        default) install .venv -c constraints.txt -e ".[test,viz,sb3,areas,cities,mcp]"; return ;;
        full) install .venv -c constraints.txt -e ".[tensorboard,viz,video,sb3,areas,onnx,cities,minari,mcp,docs,dev]" ;;
        nightly) install .venv -c constraints.txt -e ".[tensorboard,viz,video,sb3,areas,onnx,cities,minari,mcp,docs,dev,ray]" ;;
    esac
    # clients and validators that no one here wrote; pip would take an older TorchRL or python-dateutil with them
    install .venv --no-deps benchmarl==1.5.2 czml3==4.0.0
}

check() {  # what needs no test: seconds, but for the first run of mypy
    .venv/bin/lint-imports && .venv/bin/python scripts/tools/check_prose.py && .venv/bin/mypy
}

level=default
case "${1:-}" in
    --full | --nightly) level=${1#--}; shift ;;
    --basilisk) test_basilisk; exit ;;
    --rllib) test_rllib; exit ;;
    --browser) install_extras full; test_browser "${@:2}"; exit ;;
esac
if ! mkdir -p "$BSK_TORCH_CACHE" 2> /dev/null || ! [ -w "$BSK_TORCH_CACHE" ]; then
    echo "test.sh: $BSK_TORCH_CACHE cannot be written to; kernels go to a temporary folder" >&2
    BSK_TORCH_CACHE=$(mktemp -d)
fi
install_extras "$level"
.venv/bin/ruff check -q .
.venv/bin/ruff format -q --check .
.venv/bin/python -W error -c "import bsk_torch"
check > .venv/checks.txt 2>&1 &  # beside the tests
checks=$!
.venv/bin/python -W ignore -m tests.support.kernels ||
    echo "test.sh: without kernels, the tests that need them are left out" >&2
cores=$(env -u OMP_NUM_THREADS nproc)
pytest=(.venv/bin/python -m pytest)
# files in their order, each by one worker (tests/support/levels.py)
[ "$cores" = 1 ] || pytest+=(-n "$cores" --dist loadgroup --no-loadscope-reorder)
failed=0
if [ "$level" = nightly ]; then
    BSK_TORCH_FUZZ_SECONDS=60 .venv/bin/python -m pytest tests/fuzz/test_files.py || failed=1
    for part in default full nightly; do "${pytest[@]}" --levels "$part" --measure "$@" || failed=1; done
    test_browser || failed=1
    test_basilisk || failed=1
    test_rllib || failed=1
    fly_random_problems || failed=1
    .venv/bin/python scripts/tools/without_room.py || failed=1
    .venv/bin/python scripts/validation/real_orbits.py > /dev/null || failed=1
elif [ "$level" = full ] || [ $# -gt 0 ]; then
    "${pytest[@]}" --levels default,full "$@" || failed=1
else
    "${pytest[@]}" --levels default || failed=1
fi
wait "$checks" || { cat .venv/checks.txt; failed=1; }
exit "$failed"
