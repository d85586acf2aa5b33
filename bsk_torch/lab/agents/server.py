"""A server of the Model Context Protocol whose tools decide in a :class:`~bsk_torch.lab.agents.game.Game`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, TypeVar

from mcp.server.mcpserver import MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from pydantic import Field

from bsk_torch import __version__
from bsk_torch.lab.agents.game import MOST_ACTIONS, MOST_PLANS, Game

Action = Annotated[str, Field(max_length=200, description="Name of an action, as list_actions has it.")]
Actions = Annotated[list[Action], Field(min_length=1, max_length=MOST_ACTIONS)]
Plans = Annotated[list[Actions], Field(min_length=1, max_length=MOST_PLANS)]

Result = TypeVar("Result")


def said(tool: Callable[[], Result]) -> Result:
    """Return the result of a tool; its ValueError becomes a text for the agent."""
    try:
        return tool()
    except ValueError as error:
        raise ToolError(str(error)) from None


def serve(game: Game, about: str) -> MCPServer[Any]:
    """Return a server with the tools of a game; ``about`` describes the task.

    Tools are coroutines: they run in the thread of the server, one after the other, as environments require.
    """
    server: MCPServer[Any] = MCPServer(
        "bsk_torch",
        version=__version__,
        instructions=f"{about}. Decide for the satellite: observe, list_actions, what_if as often as you like, then commit. "
        "Rewards add up to the return, which is to be as large as possible. Cases follow one another; report tells the results.",
        log_level="WARNING",
    )

    @server.tool()
    async def observe() -> dict[str, Any]:
        """Show the situation in the present case: time, return so far, and observations by name."""
        return game.observe()

    @server.tool()
    async def list_actions() -> dict[str, bool]:
        """List all actions by name, and whether each is legal now."""
        return said(game.actions)

    @server.tool()
    async def what_if(plans: Plans) -> list[dict[str, Any]]:
        """Fly plans, each a list of actions, in copies of the present case, which does not change.

        Each result has the number of actions taken, their reward, the seconds that they take, whether the satellite is alive and
        the case ended, and the observations then. A plan stops before an action that is illegal at its time.
        """
        return said(lambda: game.what_if(plans))

    @server.tool()
    async def commit(actions: Actions) -> dict[str, Any]:
        """Take actions in the present case, one after the other. When it ends, the next case begins."""
        return said(lambda: game.commit(actions))

    @server.tool()
    async def report() -> dict[str, Any]:
        """Show the results of the cases that have ended: return, survival, failed checks, decisions, plans looked at."""
        return game.report()

    return server
