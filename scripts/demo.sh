#!/usr/bin/env bash
# Trains a policy from scratch and says how long each part takes: makes .venv, installs bsk_torch, trains for 75 seconds on two
# cores, compares the policy with others, draws a learning curve and an episode.
# Usage: scripts/demo.sh [options of 'bsk-torch train']     PYTHON=python3.12 scripts/demo.sh chooses the interpreter.
set -euo pipefail
case "${1:-}" in -h | --help) sed -n '2,/^set/s/^# \{0,1\}//p' "$0"; exit ;; esac
cd "$(dirname "${BASH_SOURCE[0]}")/.."

python=${PYTHON:-python3}

if [[ ! -x .venv/bin/bsk-torch ]]; then
    echo "1/2 installing into .venv: a few minutes, most of it downloads of torch"
    [[ -x .venv/bin/python ]] || "$python" -m venv .venv
    .venv/bin/python -m pip install --quiet torch==2.13.0
    .venv/bin/python -m pip install --quiet --constraint constraints.txt --editable '.[viz,video,sb3]'
    echo "installed in $((SECONDS / 60)) min $((SECONDS % 60)) s"
fi
SECONDS=0
echo "2/2 training for 75 seconds, after compiling the simulation once per machine (about 15 s on an idle core)"
.venv/bin/bsk-torch train NadirScan-v1 --minutes 1.25 --workers auto ahead=true "$@"
echo "compiled, trained, compared and drawn in $((SECONDS / 60)) min $((SECONDS % 60)) s"
echo "first of all, in each new shell: . .venv/bin/activate"
