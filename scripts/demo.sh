#!/usr/bin/env bash
# Trains a satellite from nothing in about five minutes: makes .venv, installs bsk_torch, trains, evaluates, draws.
# Usage: scripts/demo.sh [options of 'bsk-torch train']     PYTHON=python3.12 scripts/demo.sh chooses the interpreter.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

python=${PYTHON:-python3}

if [[ ! -x .venv/bin/python ]]; then
    "$python" -m venv .venv
fi
if [[ ! -x .venv/bin/bsk-torch ]]; then
    .venv/bin/python -m pip install --quiet torch==2.13.0
    .venv/bin/python -m pip install --quiet --constraint constraints.txt --editable '.[train,viz]'
fi
exec .venv/bin/bsk-torch train NadirScan-v1 --minutes 3 "$@"
