"""What users see in terminals of 80 and 100 columns, and what they do not have to wait for."""

import dataclasses
import fcntl
import inspect
import io
import logging
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import typing

import pytest
import torch
from rich.cells import cell_len
from rich.console import Console

from bsk_torch._listed import LISTED, ONE, PLANNERS
from bsk_torch.cli import main, terminal
from bsk_torch.env import ConstellationTasking
from bsk_torch.presets import PRESETS
from bsk_torch.rl.evaluation.evaluate import Evaluation
from bsk_torch.rl.evaluation.results import print_results
from bsk_torch.rl.rules.baselines import BASELINES
from bsk_torch.rl.training import progress
from bsk_torch.rl.training.config import PPOConfig

COMMANDS = {name: main.loaded(name) for name in main.COMMANDS}

ANSI = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


def widest(text):
    """Characters of the longest line."""
    return max(cell_len(line.rstrip()) for line in re.split(r"[\r\n]+", ANSI.sub("", text)))


@pytest.fixture(params=[80, 100])
def columns(request, monkeypatch):
    """Width of the terminal."""
    monkeypatch.setenv("COLUMNS", str(request.param))
    return request.param


# -- help and lists ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_fits_and_ends_with_examples(run, columns, command):
    result = run(*command.split(), "--help")
    assert result.exit_code == 0, result.output
    assert widest(result.output) <= columns
    assert "<bool>" not in result.output
    assert "range" not in result.output
    if command:
        examples = COMMANDS[command].epilog.replace("\\[", "[").splitlines()[2:]
        assert examples
        assert all(f" {example.strip()}" in result.output for example in examples)


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_are_of_their_command_and_have_options_that_exist(command):
    known = {name for parameter in COMMANDS[command].params for name in (*parameter.opts, *parameter.secondary_opts)}
    examples = [line for line in COMMANDS[command].epilog.splitlines()[2:] if line.startswith("bsk-torch")]
    assert examples
    for example in examples:
        assert f"{example} ".startswith(f"bsk-torch {command} ")
        assert {word for word in example.split() if word.startswith("--")} <= known


def test_the_overview_has_the_first_line_of_the_help_of_each_command():
    assert {name: line for name, (_, line) in main.COMMANDS.items()} == {
        name: command.help.partition("\n")[0] for name, command in COMMANDS.items()
    }


def test_commands_of_rooms_that_are_not_installed_are_named(run, monkeypatch):
    monkeypatch.setitem(main.COMMANDS, "dream", ("bsk_torch.lab.dreams.command:dream", "Dream."))
    overview = run("--help").output
    assert "Not installed: dream." in overview
    assert "Dream." not in overview
    result = run("dream", "rule")
    assert result.exit_code == 1
    assert result.output == "'dream' is not installed: this copy of bsk_torch has no folder bsk_torch/lab/dreams\n"


def test_planners_that_are_not_installed_are_named(run, monkeypatch):
    monkeypatch.setitem(PLANNERS, "beam", "bsk_torch.lab.dreams.planned:named_planner")
    result = run("eval", "plan:beam")
    assert result.exit_code == 1
    assert result.output == "'plan:beam' is not installed: this copy of bsk_torch has no folder bsk_torch/lab/dreams\n"


def test_help_names_all_baselines():
    assert all(name in COMMANDS["eval"].params[0].help for name in BASELINES)


def test_help_and_lists_do_not_wait_for_torch():
    asked = [["--help"], ["--version"], ["list"], ["list", "--long"], *([command, "--help"] for command in COMMANDS)]
    code = (
        "import sys\n"
        "from bsk_torch.cli import app\n"
        f"for arguments in {asked!r}:\n"
        "    try:\n"
        "        app(arguments)\n"
        "    except SystemExit as end:\n"
        "        assert end.code == 0, arguments\n"
        "    assert not {'torch', 'tensordict', 'matplotlib'} & set(sys.modules), arguments\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_torch_is_imported_when_it_is_needed():
    """Not by the package, nor by the registration of its environments; then attributes are there, and an environment is made."""
    code = (
        "import sys, gymnasium, bsk_torch\n"
        "assert 'bsk_torch/NadirScan-v1' in gymnasium.registry and 'torch' not in sys.modules\n"
        "assert 'SatelliteTasking' in dir(bsk_torch)\n"
        "from bsk_torch import SatelliteTasking\n"
        "assert bsk_torch.dyn.BasicDynamicsModel and bsk_torch.env.SatelliteTasking is SatelliteTasking\n"
        "assert not hasattr(bsk_torch, 'satelites')\n"
        "env = gymnasium.make('bsk_torch/NadirScan-v1', backend='eager', time_limit=60.0)\n"
        "assert env.reset(seed=0)[0].shape == (12,)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_preset_is_listed_with_its_kind():
    assert list(LISTED) == list(PRESETS)
    for name, preset in PRESETS.items():
        made = inspect.signature(preset, eval_str=True).return_annotation
        usual = next(iter(typing.get_args(made)), made)  # an option may ask for several satellites
        assert (LISTED[name].views is not ONE) == issubclass(usual, ConstellationTasking)


@pytest.mark.parametrize("options", [[], ["--long"]])
def test_presets_have_a_line_each(run, columns, options):
    result = run("list", *options)
    assert widest(result.output) <= columns
    lines = [line.split() for line in result.output.splitlines()]
    assert [line[0] for line in lines if line and line[0] in PRESETS] == list(PRESETS)
    told = [line for line in lines if line and line[0] in PRESETS and (len(line) > 2 or not options)]
    assert len({" ".join(line[1:]) for line in told}) == len(told) > 8  # presets without a policy have nothing to tell


def test_the_version_is_printed(run):
    assert run("--version").output.startswith("bsk_torch 0.")


# -- tables ------------------------------------------------------------------------------------------------------------


def evaluation(n=4):
    """Results with every column that there is."""
    value = torch.linspace(-0.5, 0.7, n, dtype=torch.float64)
    return Evaluation(
        returns=value,
        collected=value + 1.0,
        survived=value > 0.0,
        decisions=torch.full((n,), 199),
        seconds=value,
        deaths={"battery_valid": value <= 0.0, "wheel_speeds_valid": value < -0.2},
        counts={"imaged": torch.full((n,), 20)},
        fill=value.abs(),
        simulated=torch.full((n,), 1e6, dtype=torch.float64),
    )


def test_comparisons_lose_columns_by_rank(columns, capsys):
    results = {name: evaluation() for name in ("trained", "random", "rule", "untrained")}
    print_results(results, "NadirScan-v1, 4 episodes", "trained")
    shown = capsys.readouterr().out
    assert widest(shown) <= columns
    head = next(line for line in shown.splitlines() if "policy" in line)
    assert all(name in head for name in ("return", "gain of trained", "survival"))
    assert "decisions" not in head
    shown_without = " ".join(shown.split())
    assert f"not shown in {columns} columns: 95 % interval, decisions, simulated s / decision, fill, collected" in shown_without
    rows = [line.split()[0] for line in shown.splitlines() if "±" in line]
    assert rows == list(results)
    assert ("deaths" in head) == (columns == 100)


def test_eighty_columns_show_what_policies_die_of(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    results = {name: dataclasses.replace(evaluation(), counts={}, simulated=None) for name in ("trained", "random")}
    died = {"battery_valid": torch.tensor([True, True, True, False])}
    results["random"] = dataclasses.replace(results["random"], deaths=died)
    results["trained"] = dataclasses.replace(results["trained"], deaths={"battery_valid": torch.zeros(4, dtype=torch.bool)})
    print_results(results, "", "trained")
    shown = capsys.readouterr().out
    assert "3 battery" in shown
    assert "not shown in 80 columns: 95 % interval" in shown


def test_files_and_pipes_get_all_columns(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    print_results({"trained": evaluation(), "random": evaluation()}, "", "trained")
    shown = capsys.readouterr().out
    assert all(name in shown for name in ("decisions", "simulated s / decision", "fill", "collected", "imaged", "deaths"))
    assert "not shown" not in shown


# -- progress ----------------------------------------------------------------------------------------------------------


def bar_text(bar):
    """What a bar shows."""
    return "\n".join(
        "".join(segment.text for segment in line) for part in bar.get_renderables() for line in bar.console.render_lines(part)
    )


@pytest.fixture
def bar(columns, monkeypatch):
    """A bar in a terminal, which is not drawn by itself."""
    made = Console(file=io.StringIO(), force_terminal=True, width=columns)
    monkeypatch.setattr(progress, "Console", lambda **options: made)
    return progress.TrainingBar()


def row(value):
    return {"frames": 2_345_678, "seconds": 100.0, "return": value, "survival": value}


def test_the_bar_is_a_bar_and_says_no_nan(bar, columns):
    used = progress.Progress(PPOConfig(seconds=None, frames=5_000_000))
    used.frames = 2_345_678
    bar.show(used, row(float("nan")), 0)
    first = bar_text(bar)
    assert "nan" not in first
    assert "waiting for the first episodes to end" in first
    bar.show(used, row(-0.4321), 1024)
    later = bar_text(bar)
    assert "last 1,024 episodes: return -0.432, survival -43%" in later
    assert "simulated" not in later
    for text in (first, later):
        assert widest(text) <= columns
        assert len(text.splitlines()) == 2
        assert text.count("━") + text.count("╸") + text.count("╺") >= 20


def test_without_a_terminal_progress_is_logged_at_each_tenth(caplog, monkeypatch):
    monkeypatch.setattr(progress, "Console", lambda **options: Console(file=io.StringIO()))
    bar, used = progress.TrainingBar(), progress.Progress(PPOConfig(seconds=None, frames=100))
    with caplog.at_level(logging.INFO, "bsk_torch"), bar:
        for used.frames in range(1, 101):
            bar.show(used, row(0.5), 7)
    said = [record.message for record in caplog.records]
    assert len(said) == 10
    assert said[0].startswith("training 10%, ")
    assert said[-1].endswith("last 7 episodes: return 0.500, survival 50%")


@pytest.mark.parametrize(("seconds", "said"), [(5.2, "0:05"), (65.0, "1:05"), (3725.0, "1:02:05")])
def test_times_are_written_as_people_do(seconds, said):
    assert progress.duration(seconds) == said


# -- compilation -------------------------------------------------------------------------------------------------------


def record(**told):
    return logging.makeLogRecord({"msg": "compiling", "levelno": logging.INFO, "name": "bsk_torch.codegen.build", **told})


def test_kernels_are_counted_in_one_line_with_the_total_at_the_end(monkeypatch, columns):
    screen = Console(file=io.StringIO(), force_terminal=True, width=columns)
    monkeypatch.setattr(terminal, "screen", screen)
    monkeypatch.setattr(terminal, "activity", terminal.Activity())
    messages = terminal.Messages()
    messages.emit(record(kernel_folder="/home/me/.cache/bsk_torch"))
    with terminal.working("building NadirScan-v1"):
        for k in range(13):
            messages.emit(record(kernel="tick"))
            assert terminal.activity.compiled == k + 1
            assert f"compiling kernel {k + 1} (tick), once per machine" in terminal.activity.line
            messages.emit(record(kernel_seconds=4.6, folder="/home/me/.cache/bsk_torch"))
    terminal.activity.report()
    terminal.activity.report()
    shown = ANSI.sub("", screen.file.getvalue())
    assert shown.count("compiled 13 kernels in 60 s, once per machine; kept in /home/me/.cache/bsk_torch") == 1
    assert shown.count("/home/me") == 1
    assert widest(shown) <= columns


def test_messages_are_single_lines_of_files(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    terminal.print_message("word " * 50)
    assert capsys.readouterr().err == "word " * 50 + "\n"


# -- a terminal --------------------------------------------------------------------------------------------------------


def in_terminal(columns, folder, *arguments):
    """Run bsk-torch in a terminal and a folder; return the exit code and all that it writes."""
    leader, follower = pty.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")} | {"TERM": "xterm"}
    command = [sys.executable, "-m", "bsk_torch", *map(str, arguments)]
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    streams = dict(stdin=follower, stdout=follower, stderr=follower)
    process = subprocess.Popen(command, cwd=folder, env=environment, close_fds=True, **streams)
    os.close(follower)
    written = bytearray()
    while True:
        try:
            part = os.read(leader, 65536)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        written += part
    os.close(leader)
    return process.wait(), written.decode()


def drawn(written):
    """Return the lines that are left of what was written to a terminal, and the largest column that was ever reached."""
    lines, row, column, reached = [[]], 0, 0, 0
    for part in re.findall(r"\x1b\[[0-9;?]*[a-zA-Z]|[\s\S]", written):
        if part.startswith("\x1b["):
            row -= int(part[2:-1]) if part.endswith("A") else 0
            lines[row] = [] if part.endswith("K") else lines[row]
        elif part == "\r":
            column = 0
        elif part == "\n":
            row += 1
            lines += [[]] * (row == len(lines))
        else:
            lines[row] = [*lines[row][:column], *" " * (column - len(lines[row])), part, *lines[row][column + 1 :]]
            column += 1
            reached = max(reached, column if part.strip() else 0)
    return ["".join(line).rstrip() for line in lines], reached


@pytest.mark.compiled
def test_a_training_fits_the_terminal(tmp_path):
    columns = 80
    sizes = ("--frames", 40, "num_envs=4", "rollout=5", "--episodes", 2, "--time-limit", 300)
    code, written = in_terminal(columns, tmp_path, "train", "NadirScan-v1", *sizes, "--out", "run")
    assert code == 0, written
    lines, reached = drawn(written)
    assert reached <= columns
    at = next(number for number, line in enumerate(lines) if line.startswith("training"))
    assert " ".join(lines[:at]).startswith("failure_penalty=-1 is "), "the warning stands above the bar"
    assert lines[at].count("━") >= 30
    assert lines[at + 1].startswith("last ")
    assert "nan" not in written
    assert "waiting for the first episodes to end" in written
    assert "100%" in written
    assert "gain of trained" in written


def test_messages_are_shown_as_asked_for():
    code = "import logging; from bsk_torch.cli.terminal import set_verbosity, activity; set_verbosity({}); "
    said = "print(logging.getLogger().level, activity.quiet)"
    for arguments, expected in (("False, False", "20 False"), ("True, False", "10 False"), ("False, True", "30 True")):
        shown = subprocess.run([sys.executable, "-c", code.format(arguments) + said], check=True, capture_output=True, text=True)
        assert shown.stdout.strip() == expected
