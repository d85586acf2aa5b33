"""``bsk-torch audit``: the return of every action at each decision of a policy."""

from __future__ import annotations

import json
from pathlib import Path

import torch

from bsk_torch.cli.policies import named_policy
from bsk_torch.cli.shared import check_picture, check_writable, environment_options, extra, preset_options, seed_range
from bsk_torch.cli.terminal import echo, fail, working
from bsk_torch.files import write_file
from bsk_torch.lab.audit.audit import WORST, Audit, OfSituation, audit
from bsk_torch.rl.evaluation.statistics import confidence
from bsk_torch.tables import print_table

SHOWN = 5
"""Number of decisions in the list of the worst."""


def audit_policy(
    policy: str,
    preset: str | None,
    option: list[str] | None,
    seeds: str,
    horizon: float,
    gamma: float,
    futures: int | None,
    budget: int | None,
    num_envs: int,
    draw: Path | None,
    out: Path | None,
    threads: int,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Value all actions at each decision of a policy, and print where it loses; see :mod:`bsk_torch.cli.main`."""
    torch.set_num_threads(threads)
    episodes = seed_range(seeds)
    for path in (draw, out):
        check_writable(path)
    if draw is not None:
        check_picture("--draw", draw)
        extra("bsk_torch.lab.audit.figure")
    named = named_policy(policy, preset)
    env = named.environment(
        min(len(episodes), num_envs), preset_options(option) | environment_options(backend, device, time_limit)
    )
    actor = named.actor(env, device)
    try:
        with working(f"valuing all actions of {named.label}"):
            found = audit(env, actor, seeds=episodes, horizon=horizon, gamma=gamma, futures=futures, budget=budget)
    except ValueError as error:
        fail(str(error))
    title = f"{named.preset}, {named.label}, {len(episodes)} episodes, seeds {seeds}"
    print_audit(found, title)
    if draw is not None:
        extra("bsk_torch.lab.audit.figure").regret_figure(found, draw, title)
    if out is not None:
        content = {"preset": named.preset, "policy": named.label, "horizon": str(horizon), "gamma": gamma} | found.to_dict()
        write_file(out, json.dumps(content, indent=1, allow_nan=False) + "\n")


def print_audit(found: Audit, title: str) -> None:
    """Print the summary of an audit: by kind of action, by situation, and the worst decisions."""
    regret, lost = found.regret, found.regret > 0.0
    echo(title)
    echo(
        f"return {confidence(found.returns)}; regret of an episode, summed over its decisions: {found.regret_of_episodes}\n"
        f"{len(regret)} decisions, of which {int(lost.sum())} have a regret"
    )
    if not bool(lost.any()):
        return
    echo(f"the worst {WORST:.0%} of the decisions have {found.share_of_worst():.0%} of the regret\n")
    print_table(
        [
            {
                "chosen": row.chosen,
                "decisions": f"{row.decisions}",
                "mean regret": f"{row.regret:.4f}",
                "share": f"{row.share:.0%}",
                "mostly better": row.better,
            }
            for row in found.by_action()
        ],
        "Regret by chosen action",
        left=("chosen", "mostly better"),
    )
    print_table([of_situation(row) for row in found.by_situation()], "Mean regret by situation", left=("quantity",))
    names, best = found.kind(found.action), found.kind(found.best)
    print_table(
        [
            {
                "seed": f"{found.seeds[int(found.episode[k])]}",
                "time, s": f"{float(found.time[k]):,.0f}",
                "agent": f"{int(found.agent[k])}",
                "chosen": f"{names[k]} ({int(found.action[k])})",
                "best": f"{best[k]} ({int(found.best[k])})",
                "regret": f"{float(regret[k]):.4f}",
            }
            for k in found.worst(SHOWN).tolist()
            if lost[k]
        ],
        "Largest regrets",
        ("agent",),
        left=("chosen", "best"),
    )


def of_situation(row: OfSituation) -> dict[str, str]:
    """Return the cells of a quantity."""
    low, high = row.limits
    cells = (f"{mean:.4f}" if mean == mean else "" for mean in row.regret)
    return (
        {"quantity": row.quantity}
        | dict(zip(("lowest third", "middle", "highest third"), cells, strict=True))
        | {"limits of thirds": f"{low:,.4g}, {high:,.4g}"}
    )
