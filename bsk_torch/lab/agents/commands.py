"""``bsk-torch mcp``: episodes as tools of the Model Context Protocol."""

from __future__ import annotations

from bsk_torch._listed import LISTED
from bsk_torch.cli.declaration import EnvironmentOptions, Options, Preset, Seeds
from bsk_torch.cli.shared import extra, made, preset_options, seed_range
from bsk_torch.cli.terminal import refusing


def mcp(preset: Preset, seeds: Seeds = "0", option: Options = None, *, options: EnvironmentOptions) -> None:
    """Serve episodes as tools to an agent: observe, list_actions, what_if, commit, report.

    A client of the Model Context Protocol starts this command, and speaks with it over standard input and output. The seeds
    start the same episodes as in 'bsk-torch eval'. Needs the extra mcp.

    Examples:
        bsk-torch mcp NadirScan-v1 --seeds 0:8
        bsk-torch mcp AEOS-v1 --seeds 3 --option n_targets=1000
    """
    cases, server = seed_range(seeds), extra("bsk_torch.lab.agents.server", "mcp")
    env = made(preset, 1, {"env_ids": [0], **options, **preset_options(option)})
    with refusing(why=f"{preset} has no tools: "):
        game = server.Game(env, cases)
    server.serve(game, f"{preset}: {LISTED[preset].task}" if preset in LISTED else preset).run("stdio")
