"""A report is one page that says what is in the folder of a run."""

from __future__ import annotations

import dataclasses
import json
from base64 import b64decode
from html.parser import HTMLParser
from pathlib import Path

import pytest
import torch
from tensordict.nn import TensorDictModuleBase
from typer.testing import CliRunner

import bsk_torch
from bsk_torch.cli import app
from bsk_torch.cli.report import extremes
from bsk_torch.cli.run_folder import command_of
from bsk_torch.rl.networks.plans import MLPPlan
from bsk_torch.rl.policies.files import save_policy
from bsk_torch.rl.training import configure
from bsk_torch.rl.training.config import PPOConfig, save_config
from bsk_torch.viz.episodes import record
from bsk_torch.viz.figures.timeline import decision_of, runs, track_map, within
from bsk_torch.viz.figures.world import pieces
from bsk_torch.viz.report.page import clock, table, write_report


class Page(HTMLParser):
    """What a page says, and what it would load."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.images, self.loads, self.frames, self.titles, self.words, self._tags = [], [], [], [], [], []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self._tags.append(tag)
        if tag == "img":
            self.images.append(attrs)
        self.loads += [attrs[name] for name in ("src", "href") if not (attrs.get(name) or "data:").startswith("data:")]
        self.frames += [attrs["srcdoc"]] if tag == "iframe" else []
        self.loads += [tag] if tag in ("script", "link", "iframe") else []

    def handle_data(self, data):
        if data.strip():
            self.words.append(" ".join(data.split()))
            if self._tags and self._tags[-1] in ("h2", "h3"):
                self.titles.append(self.words[-1])


def read(run, tmp_path):
    return Page(write_report(run, tmp_path / "report.html").read_text())


def drawn(image):
    return b64decode(image["src"].removeprefix("data:image/svg+xml;base64,")).decode()


def test_a_page_needs_nothing_else(run, tmp_path):
    page = read(run, tmp_path)
    assert page.loads == []
    assert len(page.images) == 6  # three curves, deaths, map and timeline
    for image in page.images:
        assert drawn(image).startswith("<?xml")
        assert len(image["alt"]) > 20
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_episodes_are_in_a_viewer_whose_page_stays_text(run, tmp_path):
    flights = "<script>hacked = 1</script>"
    page = read(dataclasses.replace(run, flights=flights), tmp_path)
    assert page.loads == ["iframe"]
    assert page.frames == [flights]


def test_a_page_says_what_was_measured(run, tmp_path):
    page = read(run, tmp_path)
    titles = ["Return of an episode", "Episodes survived", "Data collected"]
    best = f"Best episode (no. 17): {run.episodes[0].episode.outcome}"
    assert page.titles == ["Learning", *titles, "Final evaluation", "Causes of death", "Episodes", best, "Configuration"]
    for words in ("0.750 ± 0.010", "1 min 01 s", "1,400", "2,000,000", "118.0 million", "64, 32", run.command):
        assert words in page.words
    assert "Report of the training run run<1>" in page.words
    assert "from -0.500 to 0.750 after 2,000,000 steps" in page.images[0]["alt"]
    assert "random: 48 battery; trained: none" in page.images[3]["alt"]


def test_the_paper_is_quoted_where_it_trained(run, tmp_path):
    quoting, plain = (read(dataclasses.replace(run, preset=preset), tmp_path) for preset in ("NadirScan-v1", "AEOS-v1"))
    assert {"The sum of an episode's rewards, as figure 2 of the paper."} < set(quoting.words)
    assert "103,000 steps" in " ".join(quoting.words)
    assert "paper" not in " ".join(plain.words)
    marked, unmarked = ([drawn(image) for image in page.images] for page in (quoting, plain))
    assert all(one != other for one, other in zip(marked[:3], unmarked[:3], strict=True))
    assert marked[3:] == unmarked[3:]  # drawn the same each time


def test_a_run_that_was_stopped_early_has_a_page(run, tmp_path):
    page = read(dataclasses.replace(run, log={}, evaluations={}, results={}), tmp_path)
    assert page.titles[0] == "Episodes"
    assert len(page.images) == 2


def test_a_table_has_no_empty_columns_and_gains_beside_the_others(run):
    rows = table(run.results)
    assert list(rows["random"]) == ["return", "survival", "fill", "deaths", "gain of trained"]
    assert list(rows["random"].values()) == ["−0.500 ± 0.010", "25.0%", "25.0%", "48 battery", "+1.250 ± 0.125"]
    assert rows["trained"]["gain of trained"] == "–"
    nobody = {name: result | {"deaths": {}, "fill": None} for name, result in run.results.items()}
    assert list(table(nobody)["random"]) == ["return", "survival", "gain of trained"]


def test_times_are_said_as_people_do():
    assert [clock(seconds) for seconds in (48.6, 59.6, 61.0, 7260.0)] == ["49 s", "1 min 00 s", "1 min 01 s", "2 h 01 min"]


def test_the_track_belongs_to_the_decisions_that_it_was_flown_in(episode, tmp_path):
    decision = decision_of(episode)
    assert torch.equal(decision.unique(), torch.arange(len(episode.actions)))
    starts = torch.searchsorted(decision, torch.arange(len(episode.actions)))
    torch.testing.assert_close(episode.track_times[starts], episode.times[:-1], rtol=0.0, atol=1e-6)
    assert within(torch.tensor([0.0, 5.0, 10.0, 25.0]), torch.tensor([[0.0, 10.0], [20.0, 30.0]])).tolist() == [
        True,
        True,
        False,
        True,
    ]
    assert not within(torch.tensor([1.0]), torch.empty(0, 2)).any()
    assert track_map(episode, tmp_path / "map.png", "NadirScan-v1").read_bytes()[:4] == b"\x89PNG"


class Counting(TensorDictModuleBase):
    """Charges, and counts its decisions in its own memory."""

    in_keys, out_keys = ["observation"], ["action", ("next", "count")]

    def forward(self, now):
        count = now.get("count", torch.zeros(now.batch_size, dtype=torch.int64)) + 1
        return now.update({"action": torch.ones_like(count), "next": {"count": count}})


@pytest.mark.compiled
def test_a_policy_remembers_while_it_is_recorded():
    env = bsk_torch.make("NadirScan-v1", num_envs=1, time_limit=300.0)
    seen = []
    policy = Counting()
    policy.register_forward_hook(lambda module, given, told: seen.append(int(told["next", "count"])))
    assert len(record(policy, env, seed=0).actions) == 3  # 120 s each, the last one cut
    assert seen == [1, 2, 3]


def test_pieces_in_a_row_are_one_line():
    x, y = torch.tensor([0.0, 1.0, 2.0, 3.0, 4.0]), torch.zeros(5)
    lines = pieces(x, y)
    assert [len(line) for line in runs(lines)] == [5]
    assert [len(line) for line in runs(lines[torch.tensor([True, False, True, True])])] == [2, 3]
    over = runs(pieces(torch.tensor([179.0, -179.0, -177.0]), y[:3]))
    assert over == [[[179.0, 0.0], [181.0, 0.0]], [[-181.0, 0.0], [-179.0, 0.0], [-177.0, 0.0]]]


# -- the command -----------------------------------------------------------------------------------------------------------------


@pytest.fixture
def call():
    threads = torch.get_num_threads()
    yield lambda *arguments: CliRunner().invoke(app, ["report", *(str(argument) for argument in arguments)])
    torch.set_num_threads(threads)


@pytest.fixture
def folder(env, tmp_path):
    """A run without logs."""
    torch.manual_seed(0)
    plan = MLPPlan.of(env, (8,))
    save_policy(tmp_path / "policy.pt", plan, plan.build(), "NadirScan-v1", {"time_limit": 150.0})
    save_config(PPOConfig(options={"time_limit": 150.0}), tmp_path / "config.yaml")
    return tmp_path


@pytest.mark.compiled
def test_the_command_plays_and_shows_three_episodes(call, folder):
    (folder / "report.html").write_text("old")
    results = {"trained": {"return": {"mean": 0.5, "half_width": 0.1}}}
    (folder / "evaluation.json").write_text(json.dumps(results))
    (folder / "log.csv").write_text("frames,seconds,simulated_days,return\n10,1,2,0.25\n20,2,4,0.5\n")
    result = call(folder, "--episodes", 3)
    assert result.exit_code == 0, result.output
    assert "report.html (" in " ".join(result.output.split())
    assert (folder / "report.html").resolve().as_uri() in result.output
    page = Page((folder / "report.html").read_text())
    assert [title.split()[0] for title in page.titles if "episode (no." in title] == ["Best", "Median", "Worst"]
    assert "0.500 ± 0.100" in page.words
    assert len(page.images) == 7
    returns = [float(title.split("return ")[1].split(",")[0]) for title in page.titles if "episode (no." in title]
    assert returns == sorted(returns, reverse=True)


@pytest.mark.compiled
def test_a_copy_without_the_viewer_reports_all_else(call, folder, monkeypatch):
    monkeypatch.setattr("bsk_torch.cli.report.absent_room", lambda path: "bsk_torch/viewer")
    result = call(folder, "--episodes", 1)
    assert result.exit_code == 0, result.output
    line = "the report does not play its episodes: this copy of bsk_torch has no folder bsk_torch/viewer"
    assert line in " ".join(result.output.split())
    text = (folder / "report.html").read_text()
    assert "<iframe" not in text
    assert Page(text).images


def test_what_is_no_run_is_refused(call, folder, monkeypatch):
    def said(path):
        result = call(path)
        assert result.exit_code == 1
        return result.output

    def missing(name):
        raise ModuleNotFoundError(name="matplotlib")

    with monkeypatch.context() as patch:
        patch.setattr("bsk_torch.cli.shared.import_module", missing)
        assert "pip install 'bsk_torch[viz]'" in said(folder)
    assert "there is no folder 'nowhere'" in said("nowhere")
    (folder / "policy.pt").rename(folder / "kept")
    assert "has no policy.pt" in said(folder)
    (folder / "policy.pt").write_text("nonsense")
    assert "is no file of a policy" in said(folder)
    (folder / "kept").rename(folder / "policy.pt")
    (folder / "config.yaml").write_text("hiden: [1]\n")
    assert "hiden" in said(folder)
    (folder / "config.yaml").unlink()
    assert "it is not a run folder" in said(folder)


def test_the_extremes_of_few_episodes_are_shown_once():
    assert extremes(torch.tensor([3.0, 1.0, 2.0, 5.0])) == {"best": 3, "median": 2, "worst": 1}
    assert extremes(torch.tensor([3.0, 1.0])) == {"best": 0, "median": 1}
    assert extremes(torch.tensor([3.0])) == {"best": 0}


@pytest.mark.parametrize(
    ("config", "command"),
    [
        (configure("NadirScan-v1"), "bsk-torch train NadirScan-v1 --network mlp --minutes 3 --seed 0"),
        (
            configure(
                "AEOS-v1", "attention", frames=1000, seconds=None, seed=2, options={"n_targets": [10, 20], "device": "cuda"}
            ),
            "bsk-torch train AEOS-v1 --network attention --frames 1000 --seed 2 --device cuda 'options.n_targets=[10,20]'",
        ),
        (
            dataclasses.replace(configure("NadirScan-v1"), hidden=(32,), patience=4, evaluate_every=1000),
            "bsk-torch train NadirScan-v1 --network mlp --minutes 3 --seed 0 'hidden=[32]' evaluate_every=1000 patience=4",
        ),
    ],
)
def test_the_command_of_a_run_is_given(config, command):
    assert command_of(config) == command


def test_the_package_carries_the_page_and_the_map():
    folder = Path(bsk_torch.__file__).parent / "viz"
    assert (folder / "report" / "report.html.jinja").is_file()
    assert (folder / "figures" / "land_110m.geojson").is_file()
