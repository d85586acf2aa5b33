"""Levels of the tests: what ``scripts/test.sh`` runs by default, with ``--full`` and with ``--nightly``.

They follow from CPU times, and from the mark ``nightly`` of tests, or parameters, that are alike to others. The file
``tests/durations.json`` lists the tests that take longer than ``SLOW``; ``pytest --measure`` writes it, in the nightly run. A new
test belongs to the default until it has been measured. A test costs what it computes itself, with its processes, and its part
of the shared fixtures that it requests, whichever test came first. A kernel that :mod:`tests.support.kernels` lists costs
nothing, because it is built before the tests; any other kernel costs its compilation in every test that loads it.
"""

import json
import resource
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from ctypes import CDLL
from pathlib import Path
from typing import NamedTuple

import pytest

from bsk_torch.codegen import build
from tests.support import kernels, programs

ROOT = Path(__file__).parents[2]

DURATIONS = ROOT / "tests" / "durations.json"

SLOW, LONG = 0.5, 60.0
"""CPU seconds above which a test runs with --full, and above which it runs at night only."""

USUAL = 0.04
"""CPU seconds of a test that is not in the file, on average: for the order of files and for shards."""

SHOWN = 20
"""Slow tests that the end of a run names."""

LEVELS = ("default", "full", "nightly")

PROMISES = {
    "ticks of Basilisk": "tests/basilisk/test_parity.py::test_ticks[arc]",
    "one of many episodes equals one alone": "tests/env/test_contract.py::test_one_alone_equals_one_of_many_bit_for_bit[eager]",
    "a script trains, compares and draws": "tests/test_scripts.py::test_runs[demo.sh-0]",
    "commands of the README": "tests/docs/test_readme.py::test_commands[runs/scan]",
    "training learns": "tests/rl/test_rl.py::test_a_short_training_beats_random_choice_of_targets[mlp]",
    "explain": "tests/lab/commands/test_explain.py::test_deaths_are_explained_and_starts_tested",
    "risk": "tests/lab/commands/test_risk.py::test_a_risk_is_estimated_and_its_ways_are_shown_saved_and_drawn",
    "bench": "tests/lab/commands/test_bench.py::test_policies_are_compared_in_the_same_episodes",
    "programs of BSK-RL": "tests/examples/test_bsk_rl.py::test_runs[simple_environment]",
    "Stable-Baselines3": "tests/test_clients.py::test_stable_baselines3",
    "installation": "tests/docs/test_pages.py::test_blocks[start/installation.md]",
    "first policy": "tests/docs/test_pages.py::test_blocks[start/first_policy.md]",
}
"""A slow test of each promise of the README, which the default runs as well."""


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("levels")
    group.addoption("--levels", default="default,full", help="levels of the tests to run: all, or some of default, full, nightly")
    group.addoption("--shard", default="1/1", help="the part of the tests to run, such as 1/2: equal parts by duration")
    group.addoption("--measure", action="store_true", help=f"write {DURATIONS.name} from the tests that have run")


def levels_of(config: pytest.Config) -> tuple[str, ...]:
    """Levels whose tests run."""
    text = config.getoption("levels")
    wanted = LEVELS if text == "all" else tuple(text.split(","))
    for name in wanted:
        if name not in LEVELS:
            raise pytest.UsageError(f"--levels {name}: must be all, or of {', '.join(LEVELS)} with commas")
    return wanted


def level(name: str, durations: dict[str, float], marks: Iterable[pytest.Mark] = ()) -> str:
    """Level of a test by its id, and by its marks: ``nightly`` is for the whole test, or for the parameters that it names."""
    seconds, parameters = durations.get(name, 0.0), f"-{name.partition('[')[2].removesuffix(']')}-"
    nightly = (mark.args for mark in marks if mark.name == "nightly")
    if name in PROMISES.values():
        return "default"
    if seconds > LONG or any(not named or any(f"-{each}-" in parameters for each in named) for named in nightly):
        return "nightly"
    return "default" if seconds <= SLOW else "full"


def read_durations() -> dict[str, float]:
    """CPU seconds of the slow tests, by id."""
    return json.loads(DURATIONS.read_text())


def _file(test: str) -> str:
    return test.partition("::")[0]


@pytest.hookimpl(tryfirst=True)  # before xdist adds groups to the ids
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the tests of the levels and the shard, the file that takes longest first."""
    durations, wanted = read_durations(), levels_of(config)
    kept = [item for item in items if level(item.nodeid, durations, item.iter_markers()) in wanted]
    groups: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in kept:
        item.stash[NAME] = item.nodeid
        groups[_group(item)].append(item)
    seconds = {name: sum(durations.get(item.nodeid, USUAL) for item in members) for name, members in groups.items()}
    mine = in_shard(seconds, *parse_shard(config.getoption("shard")))
    ordered = [item for name in sorted(mine, key=lambda name: (-seconds[name], name)) for item in groups[name]]
    config.hook.pytest_deselected(items=list(set(items) - set(ordered)))
    items[:] = ordered


def _group(item: pytest.Item) -> str:
    """Tests of a group run in one process, one after the other, and share its fixtures and libraries."""
    mark = item.get_closest_marker("xdist_group")
    file = _file(item.nodeid)
    if mark is not None:
        return str(mark.args[0])
    if file.endswith(SPLIT):
        return item.nodeid
    item.add_marker(pytest.mark.xdist_group(file))
    return file


SPLIT = ("docs/test_pages.py", "docs/test_tutorials.py", "test_scripts.py")
"""Long files whose tests share nothing, so that two workers may have their parts."""


def parse_shard(text: str) -> tuple[int, int]:
    """Number of a shard, from 1, and the number of shards."""
    number, _, count = text.partition("/")
    if not (number.isdigit() and count.isdigit() and 1 <= int(number) <= int(count)):
        raise pytest.UsageError(f"--shard {text}: must be K/N with K from 1 to N, such as 1/2")
    return int(number), int(count)


def in_shard(seconds: dict[str, float], number: int, count: int) -> list[str]:
    """Names of the groups of a shard: the longest first, each to the shard that has the least."""
    loads, parts = [0.0] * count, [[] for _ in range(count)]
    for name in sorted(seconds, key=lambda name: (-seconds[name], name)):
        least = loads.index(min(loads))
        loads[least] += seconds[name]
        parts[least].append(name)
    return parts[number - 1]


NAME = pytest.StashKey[str]()

Fixture = tuple[str, str, int]
"""A shared fixture: where it is defined, its name, and the number of its parameter."""


class Cost(NamedTuple):
    """What a test has cost: CPU seconds of its own, shared fixtures, and the kernels that it and the fixtures load."""

    seconds: float
    fixtures: list[Fixture]
    kernels: list[str]


class Meter:
    """Measures the tests of a process, and each shared fixture apart from the test for which it is made."""

    def __init__(self) -> None:
        self.compiled: dict[str, float] = {}  # CPU seconds by kernel
        self.loaded: set[str] = set()  # kernels since the test or the fixture began
        self.fixtures: dict[Fixture, tuple[float, set[str]]] = {}  # CPU seconds and kernels
        self.shared = 0.0  # CPU seconds of the fixtures that were made for this test
        build.load, build._built = self._noting_loads(build.load), self._noting_compilations(build._built)

    def _noting_loads(self, load: Callable[[str, str], CDLL]) -> Callable[[str, str], CDLL]:
        def noting(source: str, name: str) -> CDLL:
            library = load(source, name)
            self.loaded.add(Path(library._name).stem)
            return library

        return noting

    def _noting_compilations(self, compile_kernel: Callable[[str, Path, str], CDLL]) -> Callable[[str, Path, str], CDLL]:
        def noting(source: str, path: Path, name: str) -> CDLL:
            begin = self.cpu()
            library = compile_kernel(source, path, name)
            self.compiled[path.stem] = self.cpu() - begin
            return library

        return noting

    def cpu(self) -> float:
        """CPU seconds of this process, of its processes that have ended and of the fork server, but for compilations."""
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(use.ru_utime + use.ru_stime for use in used) + programs.server_seconds() - sum(self.compiled.values())

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef, request: pytest.FixtureRequest) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        before, self.loaded, begin = self.loaded, set(), self.cpu()
        try:
            return (yield)
        finally:
            seconds = self.cpu() - begin
            self.fixtures[fixturedef.baseid, fixturedef.argname, request.param_index] = seconds, self.loaded
            self.shared += seconds
            self.loaded = before

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        self.begin, self.shared, self.loaded = self.cpu(), 0.0, set()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        """The report of the teardown, which is made after this, brings the cost to the main process."""
        try:
            return (yield)
        finally:
            fixtures = [key for key in _shared_fixtures(item) if key in self.fixtures]
            loaded = self.loaded.union(*(self.fixtures[key][1] for key in fixtures))
            cost = self.cpu() - self.begin - self.shared, fixtures, sorted(loaded)
            made = [(key, self.fixtures[key][0]) for key in fixtures]
            built = {kernel: self.compiled[kernel] for kernel in loaded & self.compiled.keys()}
            item.user_properties.append(("cost", (item.stash[NAME], cost, made, built)))


def _shared_fixtures(item: pytest.Item) -> Iterator[Fixture]:
    """The shared fixtures that a test requests, directly or through other fixtures."""
    callspec = getattr(item, "callspec", None)
    for name, definitions in item._fixtureinfo.name2fixturedefs.items():
        if definitions[-1].scope != "function":
            yield definitions[-1].baseid, name, callspec.indices.get(name, 0) if callspec else 0


class Results:
    """Collects the costs of all processes, names what has become slow, and writes the file of durations."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.costs: dict[str, Cost] = {}
        self.fixtures: dict[Fixture, float] = {}
        self.compiled: dict[str, float] = {}
        self.skipped: Counter[str] = Counter()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.skipped and isinstance(report.longrepr, tuple):
            self.skipped[report.longrepr[2].removeprefix("Skipped: ")] += 1
        for name, value in report.user_properties if report.when == "teardown" else ():
            if name == "cost":
                test, (seconds, fixtures, loaded), made, built = value
                self.costs[test] = Cost(seconds, [tuple(key) for key in fixtures], loaded)
                self.fixtures |= {tuple(key): seconds for key, seconds in made}
                self.compiled |= built

    def seconds(self) -> dict[str, float]:
        """CPU seconds of the tests, each with its part of the shared fixtures and with all kernels that were not built before."""
        users = Counter(key for cost in self.costs.values() for key in cost.fixtures)
        listed = kernels.listed()
        return {
            test: cost.seconds
            + sum(self.fixtures[key] / users[key] for key in cost.fixtures)
            + sum(self.compiled.get(kernel, 0.0) for kernel in cost.kernels if kernel not in listed)
            for test, cost in self.costs.items()
        }

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        seconds, durations = self.seconds(), read_durations()
        if self.skipped:
            reasons = "; ".join(f"{count} ({reason})" for reason, count in self.skipped.most_common())
            terminalreporter.write_line(f"left out: {reasons}")
        slow = {test: value for test, value in seconds.items() if value > 2 * SLOW and test not in durations}
        for test, value in sorted(slow.items(), key=lambda item: -item[1])[:SHOWN]:
            terminalreporter.write_line(f"became slow: {value:.1f} CPU s, not in {DURATIONS.name}: {test}")
        if self.config.getoption("measure"):
            files, wanted = {_file(test) for test in seconds}, levels_of(self.config)
            earlier = {test: durations.get(test, 0.0) for test in self.reusing()}
            for test in [*durations]:
                if _file(test) in files and level(test, durations) in wanted:  # measured again, or deleted
                    del durations[test]
            measured = {test: round(max(value, earlier.get(test, 0.0)), 2) for test, value in seconds.items()}
            durations |= {test: value for test, value in measured.items() if value > SLOW and test not in durations}
            DURATIONS.write_text(json.dumps(durations, indent=0, sort_keys=True) + "\n")

    def reusing(self) -> set[str]:
        """Tests that loaded a kernel of an earlier run: without its compilation, they seem faster than they are."""
        measured = kernels.listed() | self.compiled.keys()
        return {test for test, cost in self.costs.items() if not measured.issuperset(cost.kernels)}


def pytest_configure(config: pytest.Config) -> None:
    """Processes that run tests measure them; the main one collects the costs."""
    if hasattr(config, "workerinput") or not config.getoption("numprocesses", None):
        config.pluginmanager.register(Meter(), "meter")
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Results(config), "results")
