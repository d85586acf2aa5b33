"""``bsk-torch profile``: where the time of a training goes."""

from __future__ import annotations

from typing import Annotated, Any

from bsk_torch.cli.declaration import Preset, flag
from bsk_torch.cli.terminal import activity, echo, refusing, working
from bsk_torch.cli.train import Algorithm, Changes, Network
from bsk_torch.tables import print_table


def profile(
    preset: Preset,
    changes: Changes = None,
    algorithm: Algorithm = None,
    network: Network = None,
    seconds: Annotated[float, flag("S", "CPU time to measure, without compilation.", min=0.01)] = 10.0,
    *,
    options: Annotated[dict[str, Any], ("backend", "device", "time_limit")],
) -> None:
    """Print where the CPU time of a training goes, decisions per CPU-second, and what to change.

    Nothing is kept. The training is in one process and one thread, without evaluations.

    Examples:
        bsk-torch profile NadirScan-v1
        bsk-torch profile AEOS-v1 --network attention num_envs=512 'hidden=[32]'
    """
    from bsk_torch.cli.training import configured
    from bsk_torch.rl.marl.runs import training_of
    from bsk_torch.rl.training.profile import advice, measure

    config = configured(preset, algorithm, network, changes or [], options=options)
    with refusing(), working(f"training {preset} for {seconds:g} s"):
        found = measure(config, seconds, training_of)
    activity.report()
    spent = found.spent | {"all": found.total}
    rows = [
        {"phase": phase, "us per decision": f"{us:,.2f}", "%": f"{100.0 * us / found.total:.1f}"} for phase, us in spent.items()
    ]
    print_table(rows, f"{preset}: CPU time of a training in one process and one thread", left=("phase",))
    echo(f"{1e6 / found.total:,.0f} decisions per CPU-second")
    for line in advice(found):
        echo(line)
