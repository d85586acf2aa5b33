"""What is to be published: the paper, release notes, citation, community files; their numbers are those that were measured."""

import json
import math
import re
import statistics
from datetime import date, datetime
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import pytest
import yaml

import bsk_torch
from tests.support.blocks import ROOT

PAPER = ROOT / "paper" / "paper.md"
FORMS = ROOT / ".github" / "ISSUE_TEMPLATE"

HEADINGS = [
    "Summary",
    "Statement of need",
    "State of the field",
    "Software design",
    "Research impact statement",
    "AI usage disclosure",
    "Acknowledgements",
    "References",
]
"""Sections that JOSS asks for."""

FEWEST, MOST = 750, 1750
"""Words of a paper in JOSS."""

CITED = {
    "485 core-hours": "stephenson2024",
    "16,410 scheduling scenarios of 1 to 50 satellites": "wang2025",
    "up to 1,000 satellites": "yin2026",
}
"""Numbers of others in the paper, and the entries that they are from, cited in the same sentence."""

NUMBER = re.compile(r"(?<![\w.])\d+(?:,\d{3})*(?:\.\d+)?(?![\w.]*\w)")


class Claim(NamedTuple):
    """A sentence with numbers in groups, and what they are by the results."""

    pattern: str
    numbers: list[str]


@cache
def result(name: str) -> Any:
    """A file of results."""
    return json.loads((ROOT / "benchmarks" / "results" / f"{name}.json").read_text())


def only(file: str, **values: Any) -> Any:
    """The only row of a file of results with such values."""
    (row,) = [row for row in result(file)["rows"] if all(row[key] == value for key, value in values.items())]
    return row


def percent(share: float) -> str:
    """A share as it is written."""
    return f"{100.0 * share:.1f}"


def seconds_to_beat_the_rule() -> list[float]:
    """Training times of all seeds of the recipe of NadirScan-v1 until they return more than its best rule."""
    runs = only("records", task="NadirScan-v1", threshold="beyond cautious")["runs"]
    assert all(run["reached"] and run["report"]["value"] > run["report"]["half"] for run in runs)
    return [run["seconds"] for run in runs]


def speeds() -> list[str]:
    """How many times as fast as Basilisk, in the order of the paper."""
    large, small = only("vs_basilisk", case="4096"), only("vs_basilisk", case="1")
    imaging = only("vs_basilisk_imaging", case="imaging-1k-1024")
    ratios = [[f"{row[key]:,.0f}" for key in ("ratio", "ratio_low", "ratio_high")] for row in (large, imaging)]
    return ["4,096", *ratios[0], "1,024", *ratios[1], f"{small['ratio']:.1f}"]


def agreement() -> list[str]:
    """Replays, and the largest difference of a position in mm; times, stored data and rewards must be exact."""
    rows = result("truth")["rows"]
    assert all(all(row["exact"].values()) and row["largest"]["reward"] == 0.0 for row in rows)
    farthest = max(row["largest"]["r"] for row in rows)
    return [str(len(rows)), f"{math.ceil(1e4 * farthest) / 10:.1f}"]


def problems(library: str, *kinds: str) -> list[str]:
    """Random problems in all and by result; other results must not occur."""
    found = result("differential")[library]
    assert set(found["results"]) == set(kinds)
    return [str(found["cases"]), *(str(found["results"][kind]) for kind in kinds)]


def inspectors() -> list[str]:
    """Episodes, and the mean share of successful ones without and with a filter, of ten trained policies."""
    found = result("safe_inspection_trained")
    success = {kind: [row["success"] for row in found["rows"] if row["filter"] == kind] for kind in ("none", "asif")}
    assert [len(shares) for shares in success.values()] == [10, 10]
    return [f"{found['options']['episodes']:,}", *(percent(sum(shares) / 10) for shares in success.values())]


def assurance() -> list[str]:
    """Gain in successful episodes with a filter, and half its 95 % interval (t, 9 degrees of freedom), in percentage points."""
    rows = result("safe_inspection_trained")["rows"]
    success = {(row["policy"], row["filter"]): 100.0 * row["success"] for row in rows}
    gains = [success[name, "asif"] - success[name, "none"] for name, kind in success if kind == "none"]
    half = 2.262 * statistics.stdev(gains) / math.sqrt(len(gains))
    assert half > abs(statistics.mean(gains))  # else it would be significant
    return [f"{statistics.mean(gains):.2f}", f"{half:.2f}"]


def flights() -> list[str]:
    """Decisions and episodes of a policy on Basilisk, all of which are the same as here."""
    flown = result("flight_nadir_scan")
    episodes = flown["summary"]["same_actions"]
    assert episodes == len(flown["episodes"]["seed"])
    return [f"{flown['summary']['basilisk']['decisions'][0] * episodes:,.0f}", str(episodes)]


def suite() -> list[str]:
    """Episodes of a task of the suite, which has ten tasks."""
    rows = result("suite_v1")["rows"]
    assert len({row["preset"] for row in rows}) == 10
    return [f"{max(row['episodes'] for row in rows):,}"]


def completion(policy: str) -> str:
    """Tasks that a policy completes in test cases of AEOS-Bench, in percent."""
    return f"{only('aeos_real', policy=policy)['CR']:.1f}"


def claims_of_the_paper() -> list[Claim]:
    """Every number of the paper that is no one else's."""
    n = r"([\d,.]*\d)"
    compilation = only("startup", task="scan", batch=1, dtype="float64", cache="nothing")["construction"]
    greedy, better, bound = (completion(policy) for policy in ("nearest_task", "soonest_task", "bound"))
    episodes, plain, assured = inspectors()
    return [
        Claim(f"{n} s when a new type of satellite is built", [f"{compilation:.0f}"]),
        Claim(
            rf"{n} scanning satellites are simulated {n} times as fast .*? \({n} to {n} in single turns\), and {n} imaging "
            rf"satellites {n} times as fast \({n} to {n}\) .*?; a single satellite is {n} times as fast",
            speeds(),
        ),
        Claim(
            f"Three of three training seeds .*? return more than the package's best rule within {n} s on one core",
            [str(round(max(seconds_to_beat_the_rule())))],
        ),
        Claim(f"In {n} replays of recorded flights, .* are exact, and positions agree to {n} mm", agreement()),
        Claim(
            f"Of {n} random problems .*?, {n} agree to the tolerances; {n} are chaotic .*?; in {n}, both raise the same error; "
            f"{n} differences are explained .*?, and {n} remains",
            problems("bsk_torch", "same", "chaos", "error", "explained", "different"),
        ),
        Claim(f"in all of {n} decisions of {n} episodes", flights()),
        Claim(
            f"On {n} public test cases of AEOS-Bench, .*? completes {n} % of the tasks and the benchmark's greedy rule {n} %; "
            f"no policy can complete more than {n} %",
            [str(only("aeos_real", policy="bound")["cases"]), better, greedy, bound],
        ),
        Claim(
            f"ten trained inspectors finish {n} % of {n} episodes each on average; without it, {n} %",
            [assured, episodes, plain],
        ),
        Claim(f"the difference of {n} ± {n} percentage points is not significant", assurance()),
        Claim(f"a suite of ten tasks with {n} fixed episodes", suite()),
    ]


def claims_of_the_changelog() -> list[Claim]:
    """The measured numbers of the newest entry of the changelog."""
    n = r"([\d,.]*\d)"
    imaging = only("rso_imaging", batch=1024)
    assert len(seconds_to_beat_the_rule()) == 3
    return [
        Claim(
            f"With {n} objects in each of {n} episodes, one core simulates {n} times as fast",
            [str(imaging["targets"]), f"{imaging['batch']:,}", f"{imaging['ratio']:,.0f}"],
        ),
        Claim(
            f"On {n} of its test cases, .*? completes {n} % of the tasks, .*? greedy rule {n} %, and {n} % is a bound",
            [
                str(only("aeos_real", policy="bound")["cases"]),
                *(completion(policy) for policy in ("soonest_task", "nearest_task", "bound")),
            ],
        ),
        Claim(
            f"Of {n} random programs, none differs .*?: {n} are the same, {n} are chaotic there, and {n} raise the same error",
            problems("bsk_torch.bsk_rl", "same", "chaos", "error"),
        ),
        Claim(
            f"three of three seeds return more than the best rule after at most {n} s",
            [str(round(max(seconds_to_beat_the_rule())))],
        ),
    ]


def flat(text: str) -> str:
    """A text as one line."""
    return " ".join(text.split())


def unproven(text: str, claims: list[Claim], cited: dict[str, str]) -> list[str]:
    """What is wrong with the numbers of a text: claims that it does not make, or otherwise, and numbers of no claim."""
    wrong, known = [], set()
    for pattern, numbers in claims:
        found = list(re.finditer(pattern, text))
        if [list(each.groups()) for each in found] != [numbers]:
            wrong.append(f"{pattern}: {[each.groups() for each in found]}, measured: {numbers}")
        known |= {each.start(k) for each in found for k in range(1, len(numbers) + 1)}
    for phrase, key in cited.items():
        found = [sentence for sentence in re.split(r"(?<=[.;]) (?=[A-Z])", text) if phrase in sentence]
        if not found or not all(f"@{key}" in sentence for sentence in found):
            wrong.append(f"{phrase}: not cited from {key}")
        known |= {place for each in re.finditer(re.escape(phrase), text) for place in range(*each.span())}
    return wrong + [
        f"{each[0]}: {text[each.start() - 30 : each.end() + 20]}" for each in NUMBER.finditer(text) if each.start() not in known
    ]


@pytest.fixture(scope="module")
def paper():
    """Metadata and text of the paper."""
    _, head, body = PAPER.read_text().split("---\n", 2)
    return yaml.safe_load(head), body


@pytest.fixture(scope="module")
def entries():
    """Fields of the entries of the bibliography by key."""
    text = (ROOT / "paper" / "paper.bib").read_text()
    found = re.findall(r"^@(\w+)\{(\w+),\n(.*?)^\}", text, re.MULTILINE | re.DOTALL)
    assert len(found) == text.count("@")
    fields = {key: dict(re.findall(r"^  (\w+) *= \{(.*?)\},?$", body, re.MULTILINE | re.DOTALL)) for _, key, body in found}
    assert len(fields) == len(found)
    return fields


def test_the_paper_has_the_form_that_joss_asks_for(paper):
    head, _ = paper
    assert set(head) == {"title", "tags", "authors", "affiliations", "date", "bibliography"}
    assert head["title"].startswith("bsk_torch: ")
    assert len(head["tags"]) >= 5
    assert {str(author["affiliation"]) for author in head["authors"]} == {str(place["index"]) for place in head["affiliations"]}
    orcids = [author["orcid"] for author in head["authors"] if "orcid" in author]
    assert all(re.fullmatch(r"\d{4}-\d{4}-\d{4}-\d{3}[\dX]", orcid) for orcid in orcids)
    assert datetime.strptime(head["date"], "%d %B %Y")
    assert (PAPER.parent / head["bibliography"]).is_file()
    _, body = paper
    assert re.findall(r"^# (.*)", body, re.MULTILINE) == HEADINGS
    assert not re.findall(r"^##", body, re.MULTILINE)
    words = re.sub(r"\[@[^\]]*\]|!\[|\]\([^)]*\)|\\\w+\{[^}]*\}|^# .*", " ", body, flags=re.MULTILINE).split()
    assert FEWEST <= len(words) <= MOST


def test_every_reference_of_the_paper_exists_and_is_used(paper, entries):
    _, body = paper
    assert set(re.findall(r"@(\w+)", body)) == set(entries)
    for key, fields in entries.items():
        assert {"author", "title", "year"} <= set(fields), key
        assert {"doi", "url"} & set(fields), key
        assert {"journal", "booktitle"} & set(fields), key
        assert re.fullmatch(r"10\.\d{4,}/\S+", fields.get("doi", "10.1000/none")), key
        assert fields["author"].count(",") >= fields["author"].count(" and "), key


def test_numbers_of_the_paper_were_measured_or_are_cited(paper):
    _, body = paper
    assert not unproven(flat(body), claims_of_the_paper(), CITED)
    _, body = paper
    (figure,) = re.findall(r"!\[(.*?)\]\((.*?)\)", flat(body))
    assert (PAPER.parent / figure[1]).is_file()
    (label,) = re.findall(r"\\label\{(.*?)\}", figure[0])
    assert f"\\autoref{{{label}}}" in body


def test_numbers_of_the_newest_version_in_the_changelog_were_measured():
    newest = re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)[1]
    text = flat(re.sub(r"`[^`]*`|\([^)]*\)", "", newest.partition("### Changes that may break")[0].partition("\n")[2]))
    for name in ("x86-64", "AVX2", "WGS84", "SGP4", "C99", "Stable-Baselines3", "bsk_rl 1.3.8", "Suites v1, v3", "v2"):
        text = text.replace(name, "")
    assert not unproven(text, claims_of_the_changelog(), {})


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("It is 12 times as fast.", 0),
        ("It is 13 times as fast.", 1),
        ("It is 12 times as fast. Others need 3 s.", 1),
        ("It is 12 times as fast. They need 485 core-hours [@paper].", 0),
        ("It is 12 times as fast. They need 485 core-hours. It is known [@paper].", 1),
        ("Fast.", 1),
    ],
)
def test_an_unproven_number_is_found(text, found):
    cited = {"485 core-hours": "paper"} if "485" in text else {}
    assert len(unproven(text, [Claim(r"is (1\d) times", ["12"])], cited)) == found


def versions() -> list[tuple[str, str]]:
    """Versions of the changelog and what follows them."""
    found = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    return [(version, rest.strip("- ()")) for version, _, rest in (line.partition(" ") for line in found)]


def test_the_changelog_has_dated_versions_newest_first():
    numbers = [tuple(map(int, version.split("."))) for version, _ in versions()]
    assert all(newer > older for newer, older in pairwise(numbers))
    (_, state), *released = versions()
    days = [date.fromisoformat(day) for _, day in released]
    assert all(newer >= older for newer, older in pairwise(days))
    assert state == "in development" or date.fromisoformat(state) >= days[0]


def test_the_citation_is_that_of_the_package_and_of_the_paper(entries):
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors", "abstract", "keywords", "references"} <= set(citation)
    dated = dict(versions())
    assert citation["version"] == bsk_torch.__version__
    assert str(citation["date-released"]) == dated[citation["version"]]
    assert (citation["license"], (ROOT / "LICENSE").read_text().partition("\n")[0]) == ("MIT", "MIT License")
    assert f"title   = {{{citation['title']}}}" in (ROOT / "README.md").read_text()
    titles = {fields["title"].replace("{", "").replace("}", "") for fields in entries.values()}
    assert len(citation["references"]) == 2
    assert {reference["title"] for reference in citation["references"]} <= titles


def test_entries_of_lists_have_the_versions_that_tests_use():
    text = (ROOT / "docs" / "contributing" / "listings.md").read_text()
    badges = re.findall(r"badge/(\w+)-v([\d.]+)-blue", text)
    pins = dict(re.findall(r"^([\w-]+)==([^\s;]+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    assert [name for name, _ in badges] == ["Gymnasium", "PettingZoo"]
    assert all(pins[name.lower()] == version for name, version in badges)
    entries = re.findall(r"^```markdown\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert len(entries) == 3
    assert 2 <= len(re.findall(r"\.(?=\s)", entries[0])) <= 5  # sentences of an entry of Gymnasium


def test_no_public_file_has_a_placeholder():
    places = [*ROOT.glob("*.md"), *ROOT.glob("*.cff"), *ROOT.glob("*.toml"), *ROOT.glob("paper/*.md"), *ROOT.glob("docs/**/*.md")]
    texts = [path for path in places if "_build" not in path.parts]
    assert not [path for path in texts if re.search(r"TO BE FILLED|TODO|TBD|lorem", path.read_text())]


def test_forms_of_issues_are_complete_and_are_those_that_contributors_are_told_of():
    told = set(re.findall(r"\bform \*(.*?)\*", (ROOT / "CONTRIBUTING.md").read_text()))
    forms = {path: yaml.safe_load(path.read_text()) for path in FORMS.glob("*.yml") if path.name != "config.yml"}
    assert {form["name"] for form in forms.values()} == told
    for path, form in forms.items():
        ids = [part["id"] for part in form["body"]]
        assert form["description"], path
        assert len(set(ids)) == len(ids) > 0, path
        assert any(part.get("validations", {}).get("required") for part in form["body"]), path
        assert {part["type"] for part in form["body"]} <= {"textarea", "input", "checkboxes"}, path


@pytest.mark.parametrize("name", ["README", "CONTRIBUTING", "CODE_OF_CONDUCT", "SECURITY", "ARCHITECTURE", "CHANGELOG"])
def test_links_of_pages_outside_of_the_site_lead_somewhere(name):
    text = re.sub(r"^```.*?^```", "", (ROOT / f"{name}.md").read_text(), flags=re.DOTALL | re.MULTILINE)
    links = [link for link in re.findall(r"\]\(([^)\s]+)\)", text) if not link.startswith("http")]
    assert not [link for link in links if not (ROOT / link.partition("#")[0]).exists()]
    for link in links:
        path, _, anchor = link.partition("#")
        heads = re.findall(r"^#+ (.*)", (ROOT / path).read_text(), re.MULTILINE) if anchor else []
        assert not anchor or anchor in {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}, link
