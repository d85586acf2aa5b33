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

SCAN = ("train", "NadirScan-v1", "--frames", 20)


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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("train", "NadirScan-v1", "--frames", 0), "frames=0 must be at least 1"),
        (("train", "NadirScan-v1", "--frames", -5), "frames=-5 must be at least 1"),
        (("train", "NadirScan-v1", "--minutes", "inf"), "seconds=inf must lie in (0, inf)"),
        (("train", "NadirScan-v1", "--seed", 2**70), "must be at most"),
        ((*SCAN, "options.time_limt=1"), "did you mean 'time_limit'"),
        ((*SCAN, "options.foo=1"), "unexpected keyword argument 'foo'"),
        ((*SCAN, "--episodes", 0, "options.foo=1"), "unexpected keyword argument 'foo'"),
        (("train", "AEOS-v1", "options.n_target=1"), "did you mean 'n_targets'"),
        (("train", "AEOS-v1", "options.as_set=7"), "as_set=7 must be True or False"),
        ((*SCAN, "options.sat_args.foo=1"), "sat_args['foo'] is unknown"),
        ((*SCAN, "options.sat_args=[1]"), "sat_args=[1] must be a dictionary"),
        ((*SCAN, "options.scenario=5"), "scenario=5 must be a Scenario"),
        ((*SCAN, "options.rewarder=Mine"), "rewarder='Mine' must be a rewarder"),
        ((*SCAN, "options.num_envs=5"), "the setting 'num_envs' decides that"),
        ((*SCAN, "preset=AEOS-v1"), "preset= is not a setting; give it as the first argument"),
        ((*SCAN, "network=gru"), "network= is not a setting; give it as --network"),
        ((*SCAN, "clip=-1"), "clip=-1.0 must lie in (0, 1)"),
        ((*SCAN, "hidden=[1"), "flow sequence"),
        ((*SCAN, "--time-limit", -5), "time_limit=-5"),
        ((*SCAN, "--time-limit", "nan"), "time_limit=nan"),
        ((*SCAN, "--device", "foo"), "device='foo' is not available"),
        ((*SCAN, "--backend", "foo"), "backend='foo' must be one of"),
        ((*SCAN, "--out", "file"), "'file' is not a folder"),
        ((*SCAN, "--out", "file/run"), "is not a folder"),
        ((*SCAN, "--out", "link"), "'link' is not a folder"),
        (("train", "empty", "--resume"), "'empty' is not a run folder"),
        (("train", "file", "--resume"), "'file' is not a run folder"),
        (("eval", "random", "--seeds", "5:3"), "names no episode"),
        (("eval", "random", "--seeds", f"0:{2**70}"), "seeds must be at most"),
        (("eval", "random", "--seeds", "0:99999999999"), "more than 10000000 episodes"),
        (("eval", "random", "--out", "empty"), "'empty' is a folder"),
        (("eval", "random", "--out", "nowhere/x"), "there is no folder 'nowhere'"),
        (("eval", "random", "--out", "link"), "'link' is no ordinary file"),
        (("eval", "random", "--out", "/dev/null"), "'/dev/null' is no ordinary file"),
        (("eval", "random", "--out", "a", "--episodes-out", "a"), "are the same file"),
        (("eval", "random", "--backend", "eager", "--seeds", "0:1", "--shield", ".x:f"), "relative import"),
        (("eval", "random", "--backend", "eager", "--seeds", "0:1", "--shield", "os:getcwd"), "must take the observed columns"),
        (("eval", "empty"), "there is no policy 'empty/policy.pt'"),
        (("eval", "NadirScan-v1"), "it is a preset: name a policy first, such as pretrained"),
        (("eval", "file"), "'file' is no file of a policy"),
        (("explain", "random", "--starts", "3:1"), "--starts '3:1' names no episode"),
        (("explain", "random", "--out", "empty"), "'empty' is a folder"),
        (("report", "file"), "there is no folder 'file'"),
        (("report", "empty"), "'empty' has no config.yaml"),
        (("publish", "nowhere"), "there is no folder 'nowhere'"),
        (("publish", "empty"), "'empty' has no config.yaml"),
        (("schedule", "NadirScan-v2"), "did you mean 'NadirScan-v1'"),
        (("args", "NadirScan-v2"), "did you mean 'NadirScan-v1'"),
    ],
)
def test_mistakes_are_named_in_one_line(run, folder, arguments, message):
    before = sorted(path.name for path in folder.iterdir())
    assert refused(run(*arguments), message)
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("train", "NadirScan-v1", "--minutes", "nan"),
        ("train", "NadirScan-v1", "--seed", -1),
        ("train", "NadirScan-v1", "--seeds", 0),
        ("train", "NadirScan-v1", "--episodes", -1),
        ("train", "NadirScan-v1", "--threads", 0),
        ("eval", "random", "--threads", -1),
        ("explain", "random", "--num-envs", 0),
        ("report", "run", "--episodes", -3),
        ("publish", "run", "--episodes", 1),
        ("list", "x"),
    ],
)
def test_options_out_of_range_are_refused(run, arguments):
    result = run(*arguments)
    assert result.exit_code == 2
    assert isinstance(result.exception, SystemExit)


# -- folders of runs --------------------------------------------------------------------------------------------------


@pytest.fixture
def damaged(folder):
    """A run with a sound configuration, and policy and logs that are none."""
    save_config(PPOConfig(frames=20, seconds=None), folder / "config.yaml")
    save_checksummed(folder / "policy.pt", {"x": 1})
    (folder / "log.csv").write_text("a,b\n1,2\n")
    (folder / "evaluation.json").write_text('{"trained": ')
    return folder


@pytest.mark.parametrize("command", ["eval", "report", "explain", "publish"])
def test_policies_that_are_none_are_named(run, damaged, command):
    assert refused(run(command, damaged), "policy.pt' is no policy of this version")
    (damaged / "policy.pt").write_bytes((damaged / "policy.pt").read_bytes()[:-5])
    assert refused(run(command, damaged), "policy.pt' is a damaged policy")


@pytest.mark.parametrize("command", ["report", "publish", "train"])
def test_a_configuration_reads_nothing_from_elsewhere(run, damaged, command, monkeypatch):
    monkeypatch.setenv("BSK_TORCH_SECRET", "secret")
    (damaged / "config.yaml").write_text("preset: ${oc.env:BSK_TORCH_SECRET}\n")
    result = run(command, damaged, *(["--resume"] if command == "train" else []))
    assert refused(result, "preset='${oc.env:BSK_TORCH_SECRET}' would be replaced")
    assert "secret" not in result.output


def test_logs_and_results_that_are_none_are_named(run, damaged, monkeypatch):
    for module in ("report", "publish"):
        monkeypatch.setattr(f"bsk_torch.cli.{module}.run_card", lambda folder, device: {"preset": "NadirScan-v1", "options": {}})
    assert refused(run("report", damaged), "log.csv' is no log of a training")
    assert refused(run("publish", damaged), "log.csv' is no log of a training")
    (damaged / "log.csv").write_text("frames,seconds\n")
    assert refused(run("report", damaged), "evaluation.json' holds no results of an evaluation by policy: Invalid JSON")
    assert refused(run("publish", damaged), "log.csv' has no rows")
    (damaged / "evaluation.json").write_text("[1]")
    assert refused(run("report", damaged), "evaluation.json' holds no results")
    (damaged / "log.csv").write_text("frames,seconds\n20,1\n")
    (damaged / "policies.json").write_text("[1")
    assert refused(run("publish", damaged, "--folder", damaged), "policies.json' holds no notes by preset: Invalid JSON")
    assert refused(run("publish", damaged, "--folder", damaged / "file"), "file' is not a folder")


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
    assert refused(run(*SCAN, "--out", "empty"), f"'empty' is in use by process {os.getpid()} on ")
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

    monkeypatch.setattr("bsk_torch.cli.evaluate.named_actor", interrupt)
    result = run("eval", "random", "--seeds", "0:1")
    assert (result.exit_code, result.output) == (130, "interrupted\n")
