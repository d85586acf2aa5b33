"""Whatever is wrong on the command line or in a file ends in one line that says it, not in a traceback."""

import errno
import os
from pathlib import Path

import pytest
from torch._inductor import config

from bsk_torch.codegen import build
from bsk_torch.codegen.kept import Kept
from bsk_torch.rl.policies.checksummed import save_checksummed
from bsk_torch.rl.training.config import PPOConfig, save_config
from bsk_torch.rl.training.lock import FolderLock
from bsk_torch.sim.assembly import satellite_type

pytestmark = pytest.mark.compiled

SCAN = "train NadirScan-v1 --frames 20"


def refused(result, message):
    """Whether a command said ``message`` in one line and ended with code 1."""
    assert result.exit_code == 1, result.output
    assert isinstance(result.exception, SystemExit)
    assert message in result.output
    assert len(result.output.splitlines()) == 1
    return True


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Working folder with things that are not what they should be."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("x")
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    return tmp_path


REFUSALS: list[tuple[str, int, list[str]]] = [
    ("train NadirScan-v1 --frames 0", 1, ["frames=0 must be a whole number from 1"]),
    ("train NadirScan-v1 --frames -5", 1, ["frames=-5 must be a whole number from 1"]),
    ("train NadirScan-v1 --minutes inf", 1, ["seconds=inf must be a number in (0, inf)"]),
    (f"train NadirScan-v1 --seed {2**70}", 1, ["must be a whole number from 0 to"]),
    (f"{SCAN} options.time_limt=1", 1, ["did you mean 'time_limit'"]),
    (f"{SCAN} options.foo=1", 1, ["unexpected keyword argument 'foo'"]),
    (f"{SCAN} --episodes 0 options.foo=1", 1, ["unexpected keyword argument 'foo'"]),
    ("train AEOS-v1 options.n_target=1", 1, ["did you mean 'n_targets'"]),
    ("train AEOS-v1 options.as_set=7", 1, ["as_set=7 must be True or False"]),
    (f"{SCAN} options.sat_args.foo=1", 1, ["sat_args['foo'] is unknown"]),
    (f"{SCAN} options.sat_args=[1]", 1, ["sat_args=[1] must be a dictionary"]),
    (f"{SCAN} options.scenario=5", 1, ["scenario=5 must be a Scenario"]),
    (f"{SCAN} options.rewarder=Mine", 1, ["rewarder='Mine' must be a rewarder"]),
    (f"{SCAN} options.num_envs=5", 1, ["the setting 'num_envs' decides that"]),
    (f"{SCAN} preset=AEOS-v1", 1, ["preset= is not a setting; give it as the first argument"]),
    (f"{SCAN} network=gru", 1, ["network= is not a setting; give it as --network"]),
    (f"{SCAN} learning_rat=1e-3", 1, ["did you mean 'learning_rate'"]),
    (f"{SCAN} clip=-1", 1, ["clip=-1.0 must be a number in (0, 1]"]),
    (f"{SCAN} gamma=2", 1, ["must be a number in (0, 1]"]),
    (f"{SCAN} hidden=[1", 1, ["flow sequence"]),
    (f"{SCAN} hidden=[a]", 1, ["could not be converted to Integer"]),
    (f"{SCAN} epochs=2 hidden=64", 1, ["hidden=64: ", "tuple[int, ...]"]),
    (f"{SCAN} --time-limit -5", 1, ["time_limit=-5"]),
    (f"{SCAN} --time-limit nan", 1, ["time_limit=nan"]),
    (f"{SCAN} --device foo", 1, ["device='foo' is not available"]),
    (f"{SCAN} --backend foo", 1, ["backend='foo' must be one of"]),
    (f"{SCAN} --network attention", 1, ["use network='mlp'"]),
    (f"{SCAN} --workers 3", 1, ["num_envs=1024 episodes cannot be shared out evenly among 3 processes"]),
    (f"{SCAN} --workers many", 1, ["workers='many' must be a whole number or 'auto'"]),
    (f"{SCAN} --algorithm mappo", 1, ["does not train NadirScan-v1, which has one satellite; use ppo"]),
    (f"{SCAN} --out file", 1, ["'file' is not a folder"]),
    (f"{SCAN} --out file/run", 1, ["is not a folder"]),
    (f"{SCAN} --out link", 1, ["'link' is not a folder"]),
    ("train AEOS-v1 --network attetnion", 1, ["did you mean 'attention'"]),
    ("train Constellation-v1 --algorithm ppo", 1, ["Constellation-v1, which has many satellites; use mappo or ippo"]),
    ("train Constellation-v1 --algorithm mapo", 1, ["did you mean 'mappo'"]),
    ("train Constellation-v1 --network mlp", 1, ["constellations learn with 'attention'"]),
    ("train nowhere --resume", 1, ["'nowhere' is not a run folder"]),
    ("train empty --resume", 1, ["'empty' is not a run folder"]),
    ("train file --resume", 1, ["'file' is not a run folder"]),
    ("eval random --seeds 5:3", 1, ["names no episode"]),
    ("eval random --seeds 0-5", 1, ["--seeds '0-5' must be A:B, such as 0:1000"]),
    ("eval random --seeds -3", 1, ["--seeds '-3' names no episode"]),
    (f"eval random --seeds 0:{2**70}", 1, ["seeds must be at most"]),
    ("eval random --seeds 0:99999999999", 1, ["more than 10000000 episodes"]),
    (f"eval random --backend eager --seeds {2**60}", 1, ["held out", "bsk-torch bench"]),
    ("eval random --out empty", 1, ["'empty' is a folder"]),
    ("eval random --out nowhere/x", 1, ["there is no folder 'nowhere'"]),
    ("eval random --episodes-out nowhere/x", 1, ["there is no folder 'nowhere'"]),
    ("eval random --out link", 1, ["'link' is no ordinary file"]),
    ("eval random --out /dev/null", 1, ["'/dev/null' is no ordinary file"]),
    ("eval random --out a --episodes-out a", 1, ["are the same file"]),
    ("eval random --shield .x:f", 1, ["relative import"]),
    ("eval random --shield os:getcwd", 1, ["must take the observed columns"]),
    ("eval random --shield save", 1, ["did you mean 'safe'?"]),
    ("eval random --shield nowhere:rule", 1, ["No module named 'nowhere'"]),
    ("eval random --shield math:sinn", 1, ["math has no 'sinn'; did you mean 'sin'"]),
    ("eval random random", 1, ["name each once"]),
    ("eval empty", 1, ["there is no policy 'empty/policy.pt'"]),
    ("eval file", 1, ["'file' is no file of a policy"]),
    ("explain random --starts 3:1", 1, ["--starts '3:1' names no episode"]),
    ("explain random --out empty", 1, ["'empty' is a folder"]),
    ("report file", 1, ["there is no folder 'file'"]),
    ("report empty", 1, ["'empty' has no config.yaml"]),
    ("schedule NadirScan-v2", 1, ["did you mean 'NadirScan-v1'"]),
    ("args NadirScan-v2", 1, ["did you mean 'NadirScan-v1'"]),
    ("list -v -q", 1, ["--verbose and --quiet exclude each other"]),
    ("train NadirScan-v1 --minutes nan", 2, ["--minutes"]),
    ("train NadirScan-v1 --seed -1", 2, ["--seed"]),
    ("train NadirScan-v1 --seeds 0", 2, ["--seeds"]),
    ("train NadirScan-v1 --episodes -1", 2, ["--episodes"]),
    ("train NadirScan-v1 --threads 0", 2, ["--threads"]),
    ("eval random --threads -1", 2, ["--threads"]),
    ("explain random --num-envs 0", 2, ["--num-envs"]),
    ("report run --episodes -3", 2, ["--episodes"]),
    ("list x", 2, ["unexpected extra argument"]),
    ("evl random", 2, ["No such command 'evl'", "'eval'"]),
]
"""Command lines that are refused, with the exit status and what the message contains; it is one line if the status is 1."""


@pytest.mark.parametrize(("line", "status", "names"), REFUSALS, ids=[line for line, _, _ in REFUSALS])
def test_refusals(run, folder, line, status, names):
    before = sorted(path.name for path in folder.iterdir())
    result = run(*line.split())
    assert isinstance(result.exception, SystemExit)
    assert result.exit_code == status, result.output
    assert [name for name in names if name not in " ".join(result.output.split())] == []
    assert status == 2 or len(result.output.splitlines()) == 1, result.output
    assert sorted(path.name for path in folder.iterdir()) == before


# -- folders of runs --------------------------------------------------------------------------------------------------


@pytest.fixture
def damaged(folder):
    """A run with a sound configuration, and policy and logs that are none."""
    save_config(PPOConfig(frames=20, seconds=None), folder / "config.yaml")
    save_checksummed(folder / "policy.pt", {"x": 1})
    (folder / "log.csv").write_text("a,b\n1,2\n")
    (folder / "evaluation.json").write_text('{"trained": ')
    return folder


@pytest.mark.parametrize("command", ["eval", "report", "explain"])
def test_policies_that_are_none_are_named(run, damaged, command):
    assert refused(run(command, damaged), "policy.pt' is no policy of this version")
    (damaged / "policy.pt").write_bytes((damaged / "policy.pt").read_bytes()[:-5])
    assert refused(run(command, damaged), "policy.pt' is a damaged policy")


@pytest.mark.parametrize("command", ["report", "train"])
def test_a_configuration_reads_nothing_from_elsewhere(run, damaged, command, monkeypatch):
    monkeypatch.setenv("BSK_TORCH_SECRET", "secret")
    (damaged / "config.yaml").write_text("preset: ${oc.env:BSK_TORCH_SECRET}\n")
    result = run(command, damaged, *(["--resume"] if command == "train" else []))
    assert refused(result, "preset='${oc.env:BSK_TORCH_SECRET}' would be replaced")
    assert "secret" not in result.output


def test_logs_and_results_that_are_none_are_named(run, damaged, monkeypatch):
    monkeypatch.setattr("bsk_torch.cli.run_folder.run_card", lambda folder, device: {"preset": "NadirScan-v1", "options": {}})
    assert refused(run("report", damaged), "log.csv' is no log of a training")
    (damaged / "log.csv").write_text("frames,seconds\n")
    assert refused(run("report", damaged), "evaluation.json' holds no results of an evaluation by policy: Invalid JSON")
    (damaged / "evaluation.json").write_text("[1]")
    assert refused(run("report", damaged), "evaluation.json' holds no results")


def test_a_checkpoint_that_is_damaged_is_named(run, damaged):
    save_checksummed(damaged / "checkpoint.pt", {"x": 1})
    content = (damaged / "checkpoint.pt").read_bytes()
    (damaged / "checkpoint.pt").write_bytes(content[:100] + b"\x00" + content[101:])
    before = (damaged / "config.yaml").read_bytes()
    result = run("train", damaged, "--resume", "learning_rate=0.5", "options.backend=eager", "--episodes", 2)
    assert result.exit_code == 1
    assert result.output.splitlines()[-1].endswith(
        "checkpoint.pt' is a damaged checkpoint: its checksum does not fit its content"
    )
    assert (damaged / "config.yaml").read_bytes() == before


@pytest.mark.parametrize("option", ["--seed=0", "--seeds=2", "--out=x", "--backend=eager", "--time-limit=9"])
def test_options_of_new_runs_are_refused_where_one_goes_on(run, damaged, option):
    assert refused(run("train", damaged, "--resume", option), f"{option.partition('=')[0]} is for new runs")


def test_a_folder_in_use_is_named(run, folder):
    lock = FolderLock(folder / "empty")
    assert refused(run(*SCAN.split(), "--out", "empty"), f"'empty' is in use by process {os.getpid()} on ")
    lock.release()


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder without room for files that seems writable")
@pytest.mark.parametrize(
    "arguments",
    [
        ("eval", "random", "--seeds", "0:1", "--out", "/proc/x"),
        ("dataset", "NadirScan-v1", "--seeds", "0:1", "--out", "/proc/x"),
        ("train", "NadirScan-v1", "--out", "/proc/x"),
    ],
)
def test_a_folder_without_room_for_files_is_named_before_the_work(run, folder, arguments, monkeypatch):
    monkeypatch.setattr("bsk_torch.files.os.access", lambda *_: True)  # as for the superuser
    result = run(*arguments)
    assert result.exit_code == 1
    assert "'/proc/x' cannot be " in result.output
    assert "no file can be made in the folder '/proc'" in result.output


# -- what fails in the middle of a command ----------------------------------------------------------------------------


def test_a_full_disk_is_named(run, folder, monkeypatch):
    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("bsk_torch.files.os.fsync", full)
    result = run("eval", "random", "--seeds", "0:1", "--time-limit", 60, "--out", "out.json")
    assert result.exit_code == 1
    assert result.output.splitlines()[-1] == "'out.json': cannot be written: No space left on device"
    assert not (folder / "out.json").exists()


def test_a_missing_compiler_is_named(run, folder, monkeypatch):
    monkeypatch.setenv("BSK_TORCH_CACHE", str(folder / "cache"))
    monkeypatch.setattr(build, "LOADED", {})
    monkeypatch.setattr(satellite_type, "TICKS", Kept(1))  # nothing has been built in this process
    with config.patch({"cpp.cxx": (None, "/missing/c++")}):
        result = run("eval", "random", "--seeds", "0:1", "--time-limit", 60)
    assert refused(result, "needs a C++ compiler")


def test_control_c_ends_a_command_with_a_word(run, folder, monkeypatch):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("bsk_torch.cli.policies.named_actor", interrupt)
    result = run("eval", "random", "--seeds", "0:1")
    assert (result.exit_code, result.output) == (130, "interrupted\n")
