"""The report of a training run: one HTML page that needs nothing else."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined

from bsk_torch._text import visible
from bsk_torch.files import write_file
from bsk_torch.rl.evaluation.results import TRAINED
from bsk_torch.viz.episodes import Episode, episode_of
from bsk_torch.viz.report.curves import MARKED, MEASURES, Columns, Measure, curve, deaths_chart, plain_cause, shown

__all__ = ["Chosen", "RunData", "episode_of", "write_report"]

TEMPLATE = "report.html.jinja"

PAPER_SPEED = "The paper reports 103,000 steps and 165.5 simulated days per core and hour (Apple M2 Pro)."
"""Source: section 4.2 of the BSK-RL paper."""


class Chosen(NamedTuple):
    """An episode of a report: why it is shown ("best"), its number among the played ones, and its record."""

    why: str
    number: int
    episode: Episode


@dataclass(frozen=True, kw_only=True)
class RunData:
    """Contents of a report.

    Attributes:
        name: Of the run, such as its folder.
        preset: Name of the environment.
        log: Columns of the log of training; empty if there is none.
        evaluations: Columns of the log of evaluations on unseen episodes, likewise.
        results: Final evaluation: by policy ``return`` (``mean`` and ``half_width``) and, where known, ``survival``,
            ``survival_interval``, ``collected``, ``fill``, ``deaths`` by cause, ``counts`` by name, ``episodes`` (how many) and
            ``gain`` over other policies by name.
        episodes: Episodes to be shown, in this order.
        flights: Page of the viewer with these episodes, as HTML; empty without one.
        played: Number of unseen episodes that these were chosen from.
        config: Settings by name.
        facts: What else should be noted, by name: versions, machine.
        command: Shell command that makes such a run.
    """

    name: str
    preset: str
    log: Columns
    evaluations: Columns
    results: Mapping[str, Mapping[str, Any]]
    episodes: Sequence[Chosen] = ()
    flights: str = ""
    played: int = 0
    config: Mapping[str, object] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)
    command: str = ""

    @property
    def marked(self) -> bool:
        """Whether the paper has trained in the same environment."""
        return self.preset == MARKED


class Shown(NamedTuple):
    """A figure on the page: its data URL, its caption, its alternative text, its name."""

    source: str
    caption: str
    alternative: str
    title: str = ""


def write_report(run: RunData, path: Path) -> Path:
    """Write the report of ``run`` as an HTML page that needs no other file and no network; an older one is replaced.

    Args:
        run: What is reported.
        path: The file to write.
    """
    page = Environment(
        loader=PackageLoader("bsk_torch.viz.report", "."),
        autoescape=True,
        finalize=lambda value: visible(value) if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    html = page.get_template(TEMPLATE).render(
        run=run,
        trained=TRAINED,
        summary=summary(run),
        speed=PAPER_SPEED if run.marked else "",
        curves=_curves(run),
        table=table(run.results),
        evaluated=next((result["episodes"] for result in run.results.values() if "episodes" in result), None),
        deaths=_deaths(run.results),
        episodes=[(chosen, _pictures(chosen)) for chosen in run.episodes],
        settings={name: _setting(value) for name, value in run.config.items()},
    )
    write_file(path, html)
    return path


# -- pictures --------------------------------------------------------------------------------------------------------------------


def picture(draw: Callable[[Path], Path], caption: str, alternative: str, title: str = "") -> Shown:
    """Return the picture that ``draw`` writes to a file, as an SVG within the page."""
    with TemporaryDirectory() as folder:
        data = draw(Path(folder) / "picture.svg").read_bytes()
    return Shown(f"data:image/svg+xml;base64,{b64encode(data).decode()}", caption, alternative, title)


def _curves(run: RunData) -> list[Shown]:
    pictures = []
    for measure in (measure for measure in MEASURES if shown(measure, run.log, run.evaluations)):
        caption = f"{measure.about}{f', as figure {measure.figure} of the paper' if run.marked else ''}."
        draw = partial(curve, measure, run.log, run.evaluations, marked=run.marked)
        pictures.append(picture(draw, caption, _ends(measure, run), measure.title))
    return pictures


def _ends(measure: Measure, run: RunData) -> str:
    """Description of a curve: its first and last values."""
    part = run.evaluations if run.evaluations.get(measure.name) else run.log
    values = [value for value in part[measure.name] if isfinite(value)]
    return f"{measure.title} over training: from {values[0]:.3f} to {values[-1]:.3f} after {part['frames'][-1]:,.0f} steps."


def _deaths(results: Mapping[str, Mapping[str, Any]]) -> Shown | None:
    deaths = {policy: result.get("deaths", {}) for policy, result in results.items()}
    if not any(sum(counts.values()) for counts in deaths.values()):
        return None
    words = "; ".join(f"{policy}: {_listed(counts) or 'none'}" for policy, counts in deaths.items())
    return picture(
        partial(deaths_chart, deaths),
        "Episodes of the final evaluation that ended with the loss of the satellite, by the limit that was broken.",
        f"Bar chart of deaths by policy. {words}.",
    )


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {plain_cause(cause)}" for cause, n in counts.items() if n)


def _pictures(chosen: Chosen) -> list[Shown]:
    words = f"of the {chosen.why} episode: {chosen.episode.outcome}"
    return [
        picture(partial(shown.draw, title=shown.title), shown.caption, f"{shown.alternative} {words}.")
        for shown in chosen.episode.pictures()
    ]


# -- words and numbers -----------------------------------------------------------------------------------------------------------


def summary(run: RunData) -> dict[str, str]:
    """The numbers at the top of the page, by name."""
    trained = run.results.get(TRAINED, {})
    numbers = {"return": interval(trained["return"])} if trained else {}
    numbers |= {"survival": f"{trained['survival']:.1%}"} if _number(trained.get("survival")) else {}
    if run.log:
        seconds, frames, days = (run.log[name][-1] for name in ("seconds", "frames", "simulated_days"))
        numbers |= {"steps": f"{frames:,.0f}", "training time": clock(seconds), "simulated days": f"{days:,.0f}"}
        numbers |= {"steps per hour": f"{frames / seconds * 3600.0 / 1e6:,.1f} million"}
    return numbers


def clock(seconds: float) -> str:
    """A time as people say it."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def interval(estimate: Mapping[str, float], sign: str = "") -> str:
    """A mean with the half width of its interval."""
    return f"{estimate['mean']:{sign}.3f} ± {estimate['half_width']:.3f}".replace("-", "−")


def table(results: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, str]]:
    """Return the cells of the table of the final evaluation, by policy and column; columns without numbers are left out."""
    gain = results.get(TRAINED, {}).get("gain", {})
    mortal = any(result.get("deaths") for result in results.values())
    rows = {
        policy: _row(result, mortal) | {f"gain of {TRAINED}": interval(gain[policy], "+") if policy in gain else ""}
        for policy, result in results.items()
    }
    columns = dict.fromkeys(name for row in rows.values() for name in row)
    filled = [name for name in columns if any(row.get(name, "") for row in rows.values())]
    return {policy: {name: row.get(name, "") or "–" for name in filled} for policy, row in rows.items()}


def _row(result: Mapping[str, Any], mortal: bool) -> dict[str, str]:
    """Return the cells of a policy, by column; ``collected`` is left out unless some satellite died (``mortal``)."""
    row = {"return": interval(result["return"]), "survival": survival(result)}
    for name, text in (("collected", "{:.3f}"),) * mortal + (("fill", "{:.1%}"),):
        row[name] = text.format(result[name]) if _number(result.get(name)) else ""
    row |= {name: f"{value:.1f}" for name, value in result.get("counts", {}).items()}
    return row | {"deaths": _listed(result.get("deaths", {}))}


def survival(result: Mapping[str, Any]) -> str:
    """The share of episodes survived by a policy, with its interval if known."""
    if not _number(result.get("survival")):
        return ""
    limits = " to ".join(f"{limit:.1%}" for limit in result.get("survival_interval", ()))
    return f"{result['survival']:.1%}" + f" ({limits})" * bool(limits)


def _number(value: object) -> bool:
    return isinstance(value, int | float) and isfinite(value)


def _setting(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Mapping):
        return _setting([f"{name}={_setting(part)}" for name, part in value.items()])
    if isinstance(value, list | tuple):
        return ", ".join(_setting(part) for part in value) or "none"
    return "none" if value is None else str(value)
