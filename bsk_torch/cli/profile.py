"""``bsk-torch profile``: where the time of a training goes."""

from __future__ import annotations

from bsk_torch.cli.shared import environment_options
from bsk_torch.cli.terminal import activity, echo, fail, working
from bsk_torch.cli.train import configured
from bsk_torch.rl.marl.runs import training_of
from bsk_torch.rl.training.profile import advice, measure
from bsk_torch.tables import print_table


def profile(
    preset: str,
    changes: list[str] | None,
    algorithm: str | None,
    network: str | None,
    seconds: float,
    backend: str,
    device: str,
    time_limit: float | None,
) -> None:
    """Train for a while, and print the CPU time of each phase and what to change; see :mod:`bsk_torch.cli.main`."""
    options = environment_options(backend, device, time_limit)
    config = configured(preset, algorithm, network, changes or [], options=options)
    try:
        with working(f"training {preset} for {seconds:g} s"):
            found = measure(config, seconds, training_of)
    except ValueError as error:
        fail(str(error))
    activity.report()
    spent = found.spent | {"all": found.total}
    rows = [
        {"phase": phase, "us per decision": f"{us:,.2f}", "%": f"{100.0 * us / found.total:.1f}"} for phase, us in spent.items()
    ]
    print_table(rows, f"{preset}: CPU time of a training in one process and one thread", left=("phase",))
    echo(f"{1e6 / found.total:,.0f} decisions per CPU-second")
    for line in advice(found):
        echo(line)
