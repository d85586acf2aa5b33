"""Every script, benchmark, example and recorder runs at its smallest size, and none is forgotten."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from bsk_torch.tasks.aeossp import thinned, write_solution
from tests.support.programs import run_script
from tests.support.rounding import ABSOLUTE, RELATIVE, to_rounding
from tests.tasks.aeos_bench.aeos_cases import constellation, tasks, write
from tests.tasks.aeossp.flown_case import small, write_case

ROOT = Path(__file__).parents[1]

FOLDERS = ("benchmarks", "examples", "scripts")

TRAIN = "--frames 32 num_envs=2 rollout=8 evaluate_every=32 evaluate_episodes=2 --episodes 2 --time-limit 120"
"""What makes a training of ``bsk-torch`` short."""


class Start(NamedTuple):
    """A command that takes seconds: the script's arguments, a regular expression of its output, and a marker of what it needs."""

    arguments: str
    printed: str
    needs: str


COMMANDS = r"""
benchmarks/drop_in.py --package bsk_torch.bsk_rl --program scanning --episodes 1 --limit 120
  compiled: scanning: bsk_torch\.bsk_rl: reset \d.* ms, step \d
benchmarks/bounds.py --only AEOS-v1/1000 NadirScan-v1 --episodes 1 --iterations 2 --time-limit 900
  compiled: (?s)\| AEOS-v1/1000 \| trained \| .*\| NadirScan-v1 \| rule \|[ ]
benchmarks/breakdown.py --batches 2 --seconds 0.1 --warm-up 1
  compiled: \| scan \| 2 \| all \| [\d,.]+ \| 100.0 \|
benchmarks/clouds.py --frames 32 --num-envs 2 --episodes 2 --seeds 1 --time-limit 300 --worlds poor moving --views mean
    repeats
  compiled: (?s)\| poor \| hasty by chance \| [\d.]+ \| .*\| poor \| mean \| [\d.]+ \| .*\| moving \| repeats \| [\d.]+ \|[ ]
benchmarks/compare.py --base {root} --only 1 --turns 1 --processes 1 --seconds 0.1 --warm-up 1
  compiled: \| 1 \| \d+ \| .* \| True \|
benchmarks/compare.py --base {root} --only make --turns 1 --processes 1
    --seconds 0.1 --warm-up 1 --out rows.json
  compiled: \| make \| 1 \| .* \| - \|
benchmarks/communication.py --episodes 2 --time-limit 900
  compiled: (?s)\| none \| [\d.]+ .*\| with all \| [\d.]+ \+- [\d.]+ \| [+-][\d.]+[ ]
benchmarks/constellation.py --satellites 1 2 --rows 2 --turns 1 --modes tasks
  compiled: \| tasks \| 2 \| 1 \| [\d,]+ \|
benchmarks/constellation.py --satellites 1 --rows 1 --turns 1 --modes intervals --seconds 0.1 --basilisk {python}
  basilisk: \| intervals \| 1 \| 1 \| [\d,]+ \|.*\| [\d,]+ \| [\d,]+ \|
benchmarks/difficulty.py --seeds 1 --episodes 2 --num-envs 2 --frames 32 --time-limit 300 --trainings hard curriculum
  compiled: (?s)\| curriculum \| 100.0% \|.*\| a rule \| 0.0\d\d \|
benchmarks/envelope.py --transitions 1 --scale 0.03 --time-limit 1900 --enough 1
  compiled: (?s)\| 0.20 to 0.30 \| .*\"smallest_margin\": \d
benchmarks/faults.py --seeds 1 --episodes 2 --num-envs 2 --frames 32 --time-limit 300 --trainings all
  compiled: (?s)survival.*\| cautious \| 100.0% .*return.*\| trained, faults: all \| -?[\d.]+ \|[ ]
benchmarks/faults_headroom.py --seeds 1 --episodes 2 --planned 3 --futures 1 --num-envs 2 --frames 32 --time-limit 300
  compiled: (?s)\| trained, seed 0 \| .*\| planner, past faults known \| [-\d.]+ \+- [\d.]+ \|[ ]
benchmarks/inspection.py --batch 2 --turns 1 --seconds 0.1 --warm-up 1 --only 1 manoeuvres
  compiled: \| manoeuvres \| 2 \| [\d,.]+ \| - \|
benchmarks/inspection_rules.py --episodes 2 --time-limit 700
  compiled: \| RSOInspection-v1 \| survey \| waypoints \| 0.0% \| nan \|
benchmarks/manoeuvres.py --batches 2 --targets 20 --rounds 1 --drift 2 --orbits arc
  compiled: (?s)\| 2 \| arc \| on \| [\d.]+ \|.*\| 2 \| arc \| off \| [\d.]+ \|
benchmarks/risk.py --questions charge --runs 1 --episodes 20 --repetitions 4 --plain 0 --num-envs 20 --time-limit 300
  compiled: (?s)textbook case: [\d.e-]+ for 1e-06, .*\| charge \| [\d.e+-]+ \([\d.e+-]+ to [\d.e+-]+\) \| \d+ \|
benchmarks/risk.py --questions charge --method screen --pool 100 --probabilities 0.01 --runs 1 --episodes 20 --repetitions
    4 --plain 0 --num-envs 20 --time-limit 300
  compiled: (?s)textbook case: [\d.e-]+ for 1e-02, .*\| charge \| [\d.e+-]+ \([\d.e+-]+ to [\d.e+-]+\) \| \d+ \|
benchmarks/rso_imaging.py --batches 2 --targets 3 --turns 1 --seconds 0.1 --warm-up 1 --catalogs 3 --many 2 --steps 2
  compiled: (?s)\| 2 \| 2 \| 3 \| [\d,]+ \| - \|.*\| 3 \| 2 \| [\d.]+ \| [\d.]+ \| \d+ \| \d+ \(
benchmarks/viewer_frames.py --satellites 3 --targets 200 --limit 300 --seconds 1 --turns 1 --views globe map
  browser: (?s)\| globe \| [\d.]+ \| .*\| map \| [\d.]+ \|[ ]
benchmarks/services.py --episodes 2 --time-limit 300 --targets 12 --rules rate angle
  compiled: (?s)\| rate \| [\d.]+ \+- [\d.]+ \| \+0.0 .*\| angle \|[ ]
benchmarks/expert_iteration.py --seeds 1 --episodes 2 --evaluate 2 --planned 2 --time-limit 300 --budget 2 --epochs 1
  compiled: (?s)\| audited, seed 0, round 1 \| [\d.]+ \+- [\d.]+ \| .*\| planner \|[ ]
benchmarks/aeos_speed.py --sizes 2x50 --rows 4 --turns 1 --steps 1 10 --seconds 0.1 --backend eager --plot rates.png
  compiled: (?s)\| 2 \| 50 \| 2 \| 1 \| [\d,]+ \| .*\| 2 \| 50 \| 2 \| 10 \| [\d,]+ \|[ ]
benchmarks/aeos_bench.py --cases 2 --batch 2 --time-limit 60 --satellites 2 3 --tasks 50 60
  compiled: (?s)\| nearest_task \| [\d.]+ \+- [\d.]+ \| \+0.0 .*\| soonest_task \| .*\| bound \|[ ]
benchmarks/aeossp.py --folder {root}/tests/tasks/aeossp --cases data --models flyable --margins 5
  compiled: \| data \| flyable \| 5 \| 0\.\d+ \| 0\.\d+ \|
benchmarks/aeossp_flown.py --folder {flights} --cases small --plans solution.json --slacks 5
  compiled: \| small \| solution \| 5 \|
benchmarks/aeossp_policy.py --folder {flights} --case small --learn small --frames 32 --num-envs 2
  compiled: (?s)\| small \| farsighted \| [01]\.\d+ \|.*\| small \| policy \| [01]\.\d+ \|
benchmarks/sites.py --episodes 4 --settings 4 --planned 2 --horizon 60 --futures 2 --schedules 2 --time-limit 300 --out sites.json
  compiled: commit
benchmarks/areas_headroom.py --task areas_scarce --episodes 4 --settings 2 --zooms 1 --planned 2 --time-limit 60 --out a.json
  compiled: rollout of areas, tuned
benchmarks/sites_imitation.py --seeds 0 --rounds 2 --episodes 4 --evaluate 4 --horizon 60 --epochs 1 --hidden 32 --time-limit 300
  compiled: imitation, seed 0
benchmarks/requests.py --batches 2 --requests 20 --hours 0.5 --steps 2
  compiled: \| 2 \| 20 \| 20 \| [\d.]+ \| [\d,]+ \|
benchmarks/teams.py --episodes 2 --time-limit 300 --targets 12 --only three-local walker-centralized
  compiled: (?s)\| three-local \| [\d.]+ \+- [\d.]+ \| .*\| walker-centralized \|[ ]
benchmarks/crews.py --episodes 2 --time-limit 300 --targets 12 --rules prompt
  compiled: (?s)\| prompt \| [\d.]+ \+- [\d.]+ \| .*\| \+0.0 \+- 0.0 \|
benchmarks/safe_autonomy.py --episodes 2 --batch 2 --time-limit 40 --filters none asif --policies glide rush --turns 1
    --steps 2 --backend eager
  compiled: (?s)\| CWDocking-v1 \| rush \| asif \| 0.0% \| - \| 0.0% \|.*\| CWDocking-v1 \| bsk_torch \| 2 \| [\d,]+[ ]
benchmarks/thruster_rules.py --settings 2 --episodes 2
  compiled: (?s)\| glide, tuned \| [\d.]+ \+- [\d.]+ \| \+0.0+ .*upper bound [23]\.\d
benchmarks/learners.py --learners single-file-PPO --seeds 0 --episodes 2 --settings steps=64 num-envs=4 rollout=8
    time-limit=300
  compiled: \| - \| single-file-PPO \| 0 \| 64 \| \d+ \| [-\d.]+ \+- [\d.]+ \| [-+][\d.]+ \+- [\d.]+ \|[ ]
benchmarks/learners.py --learners single-file-PPO --tasks sites --seeds 0 1 --episodes 2
    --settings steps=64 num-envs=4 rollout=8 --bench bench.json --out out.json
  compiled: \| sites \| single-file-PPO \| 1 \| 64 \| \d+ \| [-\d.]+ \+- [\d.]+ \| [-+][\d.]+ \+- [\d.]+ \|[ ]
benchmarks/memory.py --batch 4 --steps 40 --warm-up 1
  compiled: \| scan \| 40 \| [\d,.]+ \|
benchmarks/own_environments.py --only Frugal-v1 --seeds 1 --episodes 2 --frames 32 --settings num_envs=2 rollout=8
  compiled: \| Frugal-v1 \| 17,100 \| truncates \| [-\d.e]+ \| .* \(\w+\) \| [-\d.e]+ \| [01] of 1 \|
benchmarks/planners.py --presets NadirScan-v1 --episodes 2 --time-limit 300 --budget 3
  compiled: \| NadirScan-v1 \| mcts over rule \| [\d.]+ \+- [\d.]+ \|.*\| [\d,]+ \| [\d.]+ \|
benchmarks/portable.py --tasks scan --batch 4 --turns 1 --steps 2
  compiled: \| scan \| [\d.]+ \| [\d.]+ \| [\d.]+ to [\d.]+ \|
benchmarks/return_vs_computation.py --presets NadirScan-v1 --limit 300 --episodes 2 --least 1 --core-seconds 0
    --timing-seconds 0 --dearest 0
  compiled: (?s)\| rule \|  \| 2 \| .*\| tree search \| budget=12 \| 1 \| [\d.]+ \+- \w+ \|
benchmarks/return_vs_computation.py --presets AEOS-v1 --lines multipliers MILP --limit 300 --episodes 2 --least 2
    --core-seconds 0 --timing-seconds 0 --dearest 0
  compiled: (?s)\| MILP \| seconds=\d+ \| 2 \| .*\| multipliers \| iterations=3 \| 2 \|[ ]
benchmarks/return_vs_computation.py --presets AEOS-v1 --lines rule --minute 0.001 --limit 300 --episodes 1 --least 1
    --core-seconds 0 --timing-seconds 0
  compiled: \| tree search \| budget=6 \| 1 \|[ ]
benchmarks/distillation.py --presets NadirScan-v1 --limit 600 --seeds 1 --episodes 2 --evaluate 2 --epochs 1
  compiled: (?s)\| NadirScan-v1 \| planner \| .*\| student of all, seed 0 \| \d+ \| [\d.]+ \+- [\d.]+ \|
benchmarks/adversary.py --candidates 2 --each 1 --iterations 1 --elite 2 --episodes 2 --time-limit 300 --seeds 1 --frames
    32 --num-envs 2 --boxes wide
  compiled: (?s)\| wide \| package \| family \| .*\| wide \| trained on preset, seed 0 \| preset \|[ ]
benchmarks/milp.py --targets 300 --episodes 2 --seconds 2 --iterations 3 --time-limit 1900 --figure milp.png
  compiled: \| 300 \| MILP, flown \| [\d.]+ \+- [\d.]+ \| [-+\d.]+ \+- [\d.]+ \| [\d.]+% \|
benchmarks/relaxation.py --targets 300 --episodes 1 --time-limit 900 --iterations 3
  compiled: (?s)\| 300 \| least \| [\d.]+ \| [\d.]+ \| .*\| 300 \| typical \| [\d.]+ \|[ ]
benchmarks/sustained.py --scale 0.01 --planned 1 --planned-time 120 --time-limit 900 --window 120 --rounds 1
    --enough 1
  compiled: (?s)\| 0.20 to 0.21 \| .*\| AEOS-v1/9999 \| rollout over trained \| \d+ \| .*\"reserve\": \d+\.\d
benchmarks/sustained.py --fitted {root}/bsk_torch/lab/bounds/agile_sustained.json --scale 0.01 --planned 1 --searched 1
    --planned-time 120 --time-limit 600
  compiled: (?s)\| rollout over trained \| \d+ \| [\d.]+ \| .*\| beam search over trained \| \d+ \| [\d.]+ \| .*\"found\":[ ]
benchmarks/resources.py --episodes 2 --time-limit 900
  compiled: (?s)\| targets in view \| .*\| images that the store holds \| 100 \|
benchmarks/recording.py --batches 2 --every 4 --steps 1 --rounds 1
  compiled: \| scan \| 2 \| 2 \| 4 \| [\d.]+ \| [\d.]+ \|
benchmarks/off_policy.py --seeds 1 --episodes 2 --iterations 2 --time-limit 600 --share 0.3 --presets NadirScan-v1
  compiled: (?s)\| NadirScan-v1 \| pretrained,random=0.05 \| [-\d.]+ \| [-\d.]+ \| [-+].*\| NadirScan-v1 \| \d+ \| \d+ \|
benchmarks/orbiting_places.py --batch 2 --places 5 --chunk 1 --minutes 20 --range-km 3000 --arcs 5
  compiled: (?s)\| 5 \| 2 \| 0\.2 \| .*\| 5 \| \d+ \| [\d.]+ \| \d+ \|
benchmarks/reset.py --batch 4 --rows 1 --rounds 1 --shares 2 --seconds 0.1 --warm-up 1
  compiled: \| scan \| 2 \| [\d.]+% \|
benchmarks/scaling.py --batches 1 --split 2 --layouts processes --seconds 0.1 --warm-up 1
  compiled: (?s)\| scan \| 1 \| [\d,]+ \|.*\| scan \| processes \| 2 \| [\d,]+ \|
benchmarks/side_by_side.py --targets 300 --time-limit 300 --seconds 2 --budget 2
  compiled: \| MILP, flown \| \d+ \| [\d.]+ \| [\d.]+% \|
benchmarks/soak.py --cases NadirScan-v1 --scale 0.0004
  compiled: \| NadirScan-v1 \| 4,096 \| [\d,]+ \| \d+ \| [\d,.]+ \| [\d.]+ \| 0 \|
benchmarks/speedrun.py --threshold rule+-9 --seeds 0 --frames 32 --every 16 --episodes 2 --screened 2 --out r.json
    --figure r.png --settings num_envs=2 rollout=8 options.time_limit=300
  compiled: \| NadirScan-v1 \| rule\+-9 \| recipe num_envs=2 .* \| 1 of 1 \| [-\d.]+ \+- [\d.]+ \| [\d.]+ \| [\d.]+ \| 16 \|
benchmarks/startup.py --batches 1 --dtypes float64 --warm 0 --backend eager
  compiled: \| scan \| 1 \| float64 \| nothing \| [\d.]+ \|
benchmarks/state.py --tasks scan --rows 3 --rounds 1 --steps 2
  compiled: \| scan \| 3 \| [\d.]+ \|
# the file: bsk-torch bench random rule --episodes 2 --presets NadirScan-v1
benchmarks/suite.py {root}/tests/cli/bench_two_episodes.json --out suite.json
  compiled: \| NadirScan-v1 \| rule \| 2 \| - \| [\d.]+ \+- .*\n\| NadirScan-v1 \| random \| 2 \| - \| -[\d.]+ \+-
# the file: training_profile.py --cases NadirScan-v1:mlp --num-envs 4 --seconds 1
benchmarks/learner_limit.py --cases NadirScan-v1:mlp --workers 2 --seconds 0.1 --profile
    {root}/tests/rl/profile_of_four.json
  compiled: \| NadirScan-v1:mlp \| 2 \| True \| [\d,]+ \| \d+% \| - \|\n(.*\n){2}.* 1 \| True \| [\d,]+ \| \d+% \| [\d,]+ \|
benchmarks/training_profile.py --cases NadirScan-v1:mlp --seconds 0.2 --num-envs 2
  compiled: \| NadirScan-v1:mlp \| all \| [\d,.]+ \| 100.0 \|
benchmarks/vs_basilisk.py --only 1 gymnasium 64-collector --turns 1 --seconds 0.1 --warm-up 1
  compiled: (?s)\| 1 \| 1 \|.*\| gymnasium \| 1 \|.*\| 64-collector \| 64 \| float64 \| [\d,]+ \| - \|
benchmarks/vs_basilisk.py --only 1 --turns 1 --seconds 0.1 --warm-up 1 --basilisk {python}
  basilisk: \| 1 \| 1 \|.*\| [\d.]+ to [\d.]+ \|
examples/areas.py --num-envs 2 --time-limit 900 --cell 300e3 --figure areas.png
  compiled: (?s)4 areas of \d+ cells.*random: return.*areas: return .*area covered \d
examples/curriculum.py --num-envs 4 --steps 10 --time-limit 360 --rise 0.5 --figure levels.png
  compiled: (?s)step 10: \d+ episodes.*nothing was rebuilt
examples/live_requests.py --num-envs 2 --steps 12
  compiled: \d+ requests arrived and \d+ were withdrawn in .* of 2 episodes\nserved: [\d.]+% of the requests
examples/offline_cql.py --episodes 2 --time-limit 900 --steps 20 --iterations 3
  compiled: (?s)random: \d+ decisions, .*learned: return .*fitted Q with traces: .* of the pairs of actions in order
scripts/demo.sh {train} --out {tmp}/run
  compiled: trained
scripts/tools/measure_presets.py --presets CWDocking-v1 --episodes 2 --out scores.json
  compiled: glide
scripts/tools/make_readme_pictures.py speed CWDocking-v1 --out .
  compiled: (?s)speed.png.*CWDocking-v1.png
scripts/tools/make_viewer_film.py --preset NadirScan-v1 --until 900 --step 450 --out film.webp
  browser: film\.webp: \d+ frames, \d
scripts/tools/make_paper_figure.py --out evidence.png
  compiled: evidence.png
scripts/tools/make_aeos_pool.py --size 4 --batch 16 --seconds 5 --share 0 --out pool.npz
  compiled: (?s)16 of 16 candidates.*pool.npz: 4 satellites, [\d,]+ bytes
scripts/tools/make_aeos_orbits.py {orbits} --out orbits.npz
  compiled: orbits.npz: 2 orbits, [\d,]+ bytes
scripts/tools/make_coastlines.py {countries} --out land.geojson
  coastlines: 2 pieces of land
scripts/tools/without_room.py tasks/safe_autonomy --pytest tests/test_vec3.py
  compiled: tasks/safe_autonomy: left out are \d+ files .* tests
scripts/tools/make_tables.py --samples --out .
  basilisk: largest position error 0.49
scripts/validation/truth.py --only spinning --out truth.json
  compiled: spinning \(models\): .* equal: True; beyond their bounds: \[\]
scripts/validation/device.py --device cpu --presets CWDocking-v1 --measured CWDocking-v1 --batches 2 --rows 2 --seconds 0.1
    --out device.json
  compiled: (?s)parity case=CWDocking-v1 .*agrees=True.*independence .*agrees=True.*speed .*part=training .*decisions_per_s=\d
scripts/validation/mutants.py --check
  compiled: 40 faults
scripts/validation/inspect_on_basilisk.py survey --seeds 1:2 --time-limit 1300 --backend eager --out out.json
  basilisk: (?s)the same 1 episodes in bsk_torch and in Basilisk.*episodes with the same actions: 1 of 1
scripts/validation/refly_on_basilisk.py {root}/benchmarks/results/risk_paths.json --out out.json
  basilisk: (?s)bsk_torch  battery_valid after \d+ s.*Basilisk   battery_valid after \d+ s
scripts/validation/greedy_on_basilisk.py {cases} --seconds 60 --backend eager --out out.json
  basilisk: (?s)00001: CR here 0.0000, here, 1e-14 away 0.0000, Basilisk 0.0000, .*here - Basilisk
scripts/validation/drift.py --releases installed --presets NadirScan-v1 --seeds 0:1 --time-limit 900 --workers 2 --out
    out.json
  basilisk: NadirScan-v1 on [\d.]+: the first to fly; .*storage, bit 0.0e\+00 \(0.0e\+00\), .*reward 0.0e\+00
scripts/validation/fly_on_basilisk.py rule --seeds 1:2 --workers 1 --time-limit 400 --out out.json
  basilisk: the same 1 episodes in bsk_torch and in Basilisk
scripts/validation/fly_exported.py {root}/bsk_torch/rl/policies/NadirScan-v1.pt --here 0:2 --seeds none
  compiled: (?s)64 of 64 recorded decisions agree, .*2 episodes in bsk_torch: (\d+) of \1 decisions the same
scripts/validation/fly_exported.py {root}/bsk_torch/rl/policies/NadirScan-v1.pt --here 0:1 --seeds 1:2
  basilisk: 1 episodes on Basilisk, flown by the C code: (\d+) of \1 decisions the same
"""
"""Scripts with their arguments, and below each what it needs and a regular expression of its output."""


def starts() -> dict[str, list[Start]]:
    """Commands by script, run in an empty folder."""
    table: dict[str, list[Start]] = {}
    rows = re.findall(r"^([^\s#].*(?:\n    .*)*)\n  (\w+): (.*)$", COMMANDS, re.MULTILINE)
    for command, needs, printed in rows:
        path, *arguments = command.replace("{train}", TRAIN).split()
        table.setdefault(path, []).append(Start(" ".join(arguments), printed, needs))
    assert sum(map(len, table.values())) == len(rows) == len(re.findall(r"^[^\s#]", COMMANDS, re.MULTILINE))
    return table


STARTS = starts()


RECORDED = {
    "record_aeos_bench": "basilisk/recordings/aeos_bench_odd",
    "record_basilisk": "basilisk/recordings/two_seconds",
    "record_constellation": "basilisk/recordings/constellation_untasked",
    "record_craft": "basilisk/recordings/craft_steering",
    "record_examples": "basilisk/recordings/example_configuration_actions",
    "record_imaging": "basilisk/recordings/imaging_half_second",
    "record_inspection": "basilisk/recordings/inspection_dark",
    "record_los": "basilisk/recordings/los_two_seconds",
    "record_manoeuvres": "basilisk/recordings/manoeuvre_kick",
    "record_rso_imaging": "basilisk/recordings/rso_imaging_per",
    "record_models": "basilisk/recordings/models_pointing",
    "record_services": "basilisk/recordings/services",
    "record_setpoints": "basilisk/recordings/setpoint_imposed",
    "record_strips": "basilisk/recordings/strips",
    "record_modules": "sim/data/controller",
}
"""A short recording of each recorder."""

ELSEWHERE = {
    **{f"examples/bsk_rl/{path.name}": "tests/examples/test_bsk_rl.py" for path in (ROOT / "examples/bsk_rl").glob("*.py")},
    "examples/learners_torchrl.py": "tests/test_clients.py",
    "examples/mappo_benchmarl.py": "tests/test_clients.py",
    "examples/ppo_cleanrl.py": "tests/test_clients.py",
    "examples/ppo_rllib.py": "tests/test_clients.py",
    "examples/ppo_sb3.py": "tests/test_clients.py",
    "examples/share_intent.py": "tests/test_clients.py",
    "scripts/docs.sh": "tests/docs/test_site.py",
    "scripts/test.sh": ".ci/run",
    "scripts/validation/real_orbits.py": "scripts/test.sh",
    "scripts/validation/upstream.py": "tests/bsk_rl/test_upstream.py",
    "scripts/validation/differential.py": "tests/basilisk/test_differential.py",
    "scripts/tools/try_newest.sh": "tests/packaging/test_packages.py",
    "scripts/tools/check_prose.py": "tests/test_prose.py",
    "scripts/tools/update_golden.py": "tests/codegen/test_golden.py",
    "scripts/tools/make_three.py": "tests/viewer/test_page.py",
    "scripts/tools/publish_docs.py": "tests/docs/test_site.py",
    "scripts/tools/publish_policy.py": "tests/cli/test_constellation.py",
    "scripts/recorders/record_arguments.py": "tests/test_scripts.py",
    "scripts/recorders/record_lost_passes.py": "tests/test_scripts.py",
    "scripts/recorders/record_drop_in.py": "tests/basilisk/test_drop_in.py",
    "scripts/recorders/record_bsk_rl.py": "tests/basilisk/test_drop_in.py",
    **{f"scripts/recorders/{script}.py": "tests/test_scripts.py" for script in RECORDED},
}
"""Scripts that other tests start, and where."""

REPLAYED_ONLY = {
    "scripts/recorders/record_afrl_crews.py": "tests/tasks/safe_autonomy/test_crews.py",
    "scripts/recorders/record_afrl_docking.py": "tests/tasks/safe_autonomy/test_docking.py",
    "scripts/recorders/record_afrl_filters.py": "tests/tasks/safe_autonomy/test_filters.py",
    "scripts/recorders/record_afrl_inspection.py": "tests/tasks/safe_autonomy/test_inspection.py",
    "scripts/recorders/record_skyfield.py": "tests/sim/access/test_eclipses.py",
    "scripts/recorders/record_aeossp.py": "tests/tasks/aeossp/part.py",
    "scripts/tools/make_nutation.py": "tests/astro/test_earth_rotation.py",
    "scripts/tools/make_samples.py": "tests/formats/test_places.py",
    "scripts/tools/station_table.py": "tests/formats/test_places.py",
}
"""Scripts that no test starts, because they need programs or files of others, and what tests their recordings and tables."""

STARTED_BY_OTHERS = {
    "benchmarks/basilisk_side.py": "benchmarks/harness.py",
    "benchmarks/safe_autonomy_side.py": "benchmarks/safe_autonomy.py",
    "benchmarks/aeos_speed_side.py": "benchmarks/aeos_speed.py",
}
"""Scripts that others start in another interpreter: their names occur there."""

RUNS = [
    pytest.param(path, start, marks=[pytest.mark.compiled, getattr(pytest.mark, start.needs)], id=f"{Path(path).name}-{k}")
    for path, starts in STARTS.items()
    for k, start in enumerate(starts)
]


def run(folder: Path, path: str, *arguments: str) -> str:
    """What a script prints; its errors are shown where it fails."""
    environment = {"OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    if path.endswith(".py"):
        result = run_script(ROOT / path, *arguments, folder=folder, environment=environment)
    else:
        command, surroundings = ["bash", str(ROOT / path), *arguments], os.environ | environment
        result = subprocess.run(command, cwd=folder, env=surroundings, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.mark.parametrize(("path", "start"), RUNS)
@pytest.mark.nightly("risk.py-1", "return_vs_computation.py-1", "sustained.py-1")
def test_runs(path, start, tmp_path):
    if path == "scripts/demo.sh" and not (ROOT / ".venv/bin/bsk-torch").exists():
        pytest.skip("needs .venv, which scripts/test.sh makes")
    values = {"root": str(ROOT), "python": sys.executable, "countries": "countries.whl", "tmp": str(tmp_path)}
    values |= {"orbits": "orbits.zip", "cases": "cases", "flights": "flights"}
    if "{countries}" in start.arguments:
        write_countries(tmp_path / values["countries"])
    if "{orbits}" in start.arguments:
        write_orbits(tmp_path / values["orbits"])
    if "{cases}" in start.arguments:
        for name in ("00001", "00002"):
            write(tmp_path / "cases" / name, constellation(2), tasks(40))
    if "{flights}" in start.arguments:
        case, plan = small()
        write_case(tmp_path / "flights" / "small", case)
        write_solution(tmp_path / "flights" / "small" / "solution.json", case, thinned(case, plan, 0.0))
    printed = run(tmp_path, path, *start.arguments.format(**values).split())
    assert re.search(start.printed, printed), printed


def write_countries(wheel: Path) -> None:
    """A wheel with the borders of two neighbours and an island, in place of that of geopandas."""
    import shapefile

    with shapefile.Writer(str(wheel.with_suffix("")), shapeType=shapefile.POLYGON) as writer:
        writer.field("name", "C")
        for k in (0, 1, 5):
            writer.poly([[[k, 0], [k, 1], [k + 1, 1], [k + 1, 0], [k, 0]]])
            writer.record(f"country {k}")
    with zipfile.ZipFile(wheel, "w") as archive:
        for kind in ("shp", "shx", "dbf"):
            archive.write(wheel.with_suffix(f".{kind}"), f"geopandas/datasets/naturalearth_lowres/naturalearth_lowres.{kind}")


def write_orbits(path: Path) -> None:
    """Two orbits in the files of AEOS-Bench."""
    names = ("eccentricity", "semi_major_axis", "inclination", "right_ascension_of_the_ascending_node", "argument_of_perigee")
    with zipfile.ZipFile(path, "w") as archive:
        for k in (7, 3):
            values = {"id": k} | dict(zip(names, (2.555e-4, 6921000.0, 70.0008, 49.064, 259.1988), strict=True))
            archive.writestr(f"orbits/{k}.json", json.dumps(values))


JSON_TEXTS = ("constellation", "taskset")
"""Arrays of recordings that hold a scenario of AEOS-Bench as JSON."""


@pytest.mark.basilisk
@pytest.mark.parametrize(("script", "recording"), RECORDED.items())
def test_a_recording_can_be_repeated(script, recording, tmp_path):
    name = Path(recording).name
    run(tmp_path, f"scripts/recorders/{script}.py", name, "--out", ".")
    with np.load(tmp_path / f"{name}.npz") as new, np.load(ROOT / "tests" / f"{recording}.npz") as old:
        assert set(new.files) == set(old.files)
        for key in set(old.files) - {"sensitivity", "versions"}:  # rounding errors as such, and what they depend on
            if old[key].dtype.kind == "f":
                np.testing.assert_allclose(new[key], old[key], rtol=RELATIVE, atol=ABSOLUTE, err_msg=key)
            elif key in JSON_TEXTS:
                assert json.loads(str(new[key])) == to_rounding(json.loads(str(old[key]))), key
            else:
                np.testing.assert_array_equal(new[key], old[key], err_msg=key)


@pytest.mark.basilisk
def test_tables_of_arguments_and_epochs_can_be_repeated(tmp_path):
    run(tmp_path, "scripts/recorders/record_arguments.py", "--out", ".")
    for name in ("default_args.json", "epochs.json"):
        assert (tmp_path / name).read_text() == (ROOT / "tests/sim/data" / name).read_text()


@pytest.mark.basilisk
def test_windows_that_bsk_rl_loses_can_be_recorded_again(tmp_path):
    run(tmp_path, "scripts/recorders/record_lost_passes.py", "--out", ".")
    new, old = (
        json.loads((folder / "lost_passes.json").read_text()) for folder in (tmp_path, ROOT / "tests/basilisk/recordings")
    )
    assert new["orbits"].keys() == old["orbits"].keys()
    for name, before in old["orbits"].items():
        for part in ("windows", "more"):
            assert [station for station, *_ in new["orbits"][name][part]] == [station for station, *_ in before[part]]
            np.testing.assert_allclose(
                [times for _, *times in new["orbits"][name][part]],
                [times for _, *times in before[part]],
                atol=1e-6,
                err_msg=name,
            )  # other processors round otherwise


# -- completeness -----------------------------------------------------------------------------------------------------


def imported(path: Path) -> set[str]:
    """Names of the top-level modules that a script imports anywhere."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    direct = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    return direct | {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}


def test_every_script_is_started():
    files = {path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".sh")}
    names = {str(path.relative_to(ROOT)) for path in files}
    started = {*STARTS, *ELSEWHERE, *REPLAYED_ONLY}
    assert started <= names, f"there is no {', '.join(sorted(started - names))}"
    for path, where in (ELSEWHERE | REPLAYED_ONLY | STARTED_BY_OTHERS).items():
        assert Path(path).stem in (ROOT / where).read_text(), f"{where} does not start {path}"
    reached = started | set(STARTED_BY_OTHERS)
    modules = [(Path(name).stem, name) for name in names if name.endswith(".py")]
    waiting = list(reached)
    while waiting:  # and what those import
        path = waiting.pop()
        imports = imported(ROOT / path) if path.endswith(".py") else set()
        found = {name for module, name in modules if module in imports}
        waiting += found - reached
        reached |= found
    assert not names - reached, f"no test starts {', '.join(sorted(names - reached))}: add them to STARTS"


@pytest.mark.parametrize(
    ("script", "usage"),
    [
        ("scripts/tools/publish_docs.py", "usage: publish_docs.py [-h] pages site"),
        ("scripts/tools/check_prose.py", "usage: check_prose.py [-h] [file ...]"),
        ("scripts/demo.sh", "Usage: scripts/demo.sh"),
        ("scripts/docs.sh", "scripts/docs.sh --quick"),
        ("scripts/test.sh", "scripts/test.sh tests/sim -k orbit"),
        ("scripts/tools/try_newest.sh", "scripts/tools/try_newest.sh [pytest arguments"),
    ],
)
def test_help_explains_and_does_nothing(script, usage, tmp_path):
    printed = run(tmp_path, script, "--help")
    assert usage in printed
    assert not list(tmp_path.iterdir())


def test_scripts_are_executable_and_read_no_arguments_by_position():
    paths = [path for folder in ("benchmarks", "scripts") for path in (ROOT / folder).rglob("*.py")]
    assert len(paths) > 20
    for path in paths:
        assert "sys.argv" not in path.read_text(), f"{path} takes --help for an argument: read them by argparse"
    scripts = [*(ROOT / "scripts").glob("*.sh"), ROOT / ".ci/run"]
    assert len(scripts) >= 3
    for script in scripts:
        assert shutil.which(str(script)), f"{script} is not executable"
        subprocess.run(["bash", "-n", str(script)], check=True)
