"""``bsk-torch audit``: the return of every action at each decision of a policy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from bsk_torch.cli.declaration import AtOnce, EnvironmentOptions, OfPreset, Options, Policy, Seeds, Trust, flag
from bsk_torch.cli.shared import check_writable, drawing, preset_options, seed_range
from bsk_torch.cli.terminal import echo, refusing, working
from bsk_torch.files import write_file
from bsk_torch.tables import print_table

if TYPE_CHECKING:
    from bsk_torch.lab.audit.audit import Audit, OfSituation

SHOWN = 5
"""Number of decisions in the list of the worst."""


def audit_policy(
    policy: Policy,
    preset: OfPreset = None,
    option: Options = None,
    seeds: Seeds = "0:8",
    horizon: Annotated[float, flag("S", "Length of branches in seconds; 'inf': to the end of the episode.")] = float("inf"),
    gamma: Annotated[float, flag("G", "Discount per second.", min=0.0, max=1.0)] = 1.0,
    futures: Annotated[int | None, flag("N", "Futures drawn for each decision; default: the true one.", min=2)] = None,
    budget: Annotated[int | None, flag("N", "Value only the N actions that the policy prefers; default: all.", min=1)] = None,
    num_envs: AtOnce = 16,
    draw: Annotated[Path | None, flag("FILE", "Picture (.png, .svg, .pdf) of the regrets.")] = None,
    out: Annotated[Path | None, flag("FILE", "JSON file for all decisions.")] = None,
    trust: Trust = False,
    *,
    options: EnvironmentOptions,
) -> None:
    """Find the decisions at which a policy loses, by flying all other actions as well.

    The regret of a decision is the return of the best action minus the return of the chosen action; the policy follows both.

    Examples:
        bsk-torch audit runs/scan --seeds 0:16 --draw regret.png
        bsk-torch audit pretrained --preset AEOS-v1 --horizon 300 --budget 8
        bsk-torch audit hasty --preset CloudyAEOS-v1 --horizon 300 --futures 8
    """
    from bsk_torch.cli.policies import flown
    from bsk_torch.lab.audit.audit import audit

    episodes = seed_range(seeds)
    figure = drawing(draw, "bsk_torch.lab.audit.figure")
    check_writable(out)
    named, env, actor = flown(policy, preset, min(len(episodes), num_envs), preset_options(option) | options, trust)
    with refusing(), working(f"valuing all actions of {named.label}"):
        result = audit(env, actor, seeds=episodes, horizon=horizon, gamma=gamma, futures=futures, budget=budget)
    title = f"{named.preset}, {named.label}, {len(episodes)} episodes, seeds {seeds}"
    print_audit(result, title)
    if draw is not None:
        figure.regret_figure(result, draw, title)
    if out is not None:
        content = {"preset": named.preset, "policy": named.label, "horizon": str(horizon), "gamma": gamma} | result.to_dict()
        write_file(out, json.dumps(content, indent=1, allow_nan=False) + "\n")


def print_audit(audit: Audit, title: str) -> None:
    """Print the summary of an audit: by kind of action, by situation, and the worst decisions."""
    from bsk_torch.lab.audit.audit import WORST
    from bsk_torch.rl.evaluation.statistics import confidence

    regret, losses = audit.regret, audit.regret > 0.0
    echo(title)
    echo(
        f"return {confidence(audit.returns)}; regret of an episode, summed over its decisions: {audit.regret_of_episodes}\n"
        f"{len(regret)} decisions, of which {int(losses.sum())} have a regret"
    )
    if not bool(losses.any()):
        return
    echo(f"the worst {WORST:.0%} of the decisions have {audit.share_of_worst():.0%} of the regret\n")
    print_table(
        [
            {
                "chosen": row.chosen,
                "decisions": f"{row.decisions}",
                "mean regret": f"{row.regret:.4f}",
                "share": f"{row.share:.0%}",
                "mostly better": row.better,
            }
            for row in audit.by_action()
        ],
        "Regret by chosen action",
        left=("chosen", "mostly better"),
    )
    print_table([of_situation(row) for row in audit.by_situation()], "Mean regret by situation", left=("quantity",))
    names, best = audit.kind(audit.action), audit.kind(audit.best)
    print_table(
        [
            {
                "seed": f"{audit.seeds[int(audit.episode[k])]}",
                "time, s": f"{float(audit.time[k]):,.0f}",
                "agent": f"{int(audit.agent[k])}",
                "chosen": f"{names[k]} ({int(audit.action[k])})",
                "best": f"{best[k]} ({int(audit.best[k])})",
                "regret": f"{float(regret[k]):.4f}",
            }
            for k in audit.worst(SHOWN).tolist()
            if losses[k]
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
