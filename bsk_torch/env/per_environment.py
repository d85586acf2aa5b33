"""The adapter of what is written for one episode: it is called for each environment of a batch."""

from __future__ import annotations

import copy
from typing import Any

from bsk_torch.comm.base import CommunicationMethod
from bsk_torch.comm.mapped import PerEnvironmentCommunication
from bsk_torch.data.base import GlobalReward
from bsk_torch.data.mapped import PerEnvironmentReward
from bsk_torch.sats.user_function import adapted
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.mapped import PerEnvironmentTargets


def per_environment(given: Any) -> Any:
    """Return what runs code for one episode in each environment of a batch; also a decorator.

    A function of one satellite, in an observation (also ``get_obs``, and properties of models), a resource reward or an access
    filter, may return numbers and NumPy arrays, and call NumPy. It is called once for all environments if that gives the same,
    else for one after the other, with a warning in the log.

    A rewarder, an object with the hooks of ``bsk_torch.bsk_rl.data.GlobalReward``, becomes a rewarder of the batch. Every episode
    begins with a deep copy of it; its stores are saved and restored with the episodes. ``satellite`` in its hooks is a view of
    one satellite, :class:`bsk_torch.sats.one.OneSatellite`, and ``rewarder.rewarder_of(row)`` the copy of an environment.

    A communication method, an object with the hooks of ``bsk_torch.bsk_rl.comm.CommunicationMethod``, becomes one of the batch:
    its ``communication_pairs()`` is called for each environment, with views in ``self.satellites``; its other hooks are not.

    A scenario whose class derives from ``bsk_torch.bsk_rl.scene.UniformTargets`` becomes one of the batch: a deep copy makes the
    targets of each episode in ``regenerate_targets()``; its other hooks are not called.

    Its time is that of the Python code times the number of environments, in every step: see ``docs/migration_fast.md``.

    Args:
        given: The function, rewarder, communication method or scenario.

    Raises:
        TypeError: For anything else.

    Example:
        >>> from bsk_torch.bsk_rl.data import NoReward
        >>> rewarder = per_environment(NoReward())
        >>> radius = per_environment(lambda satellite: np.linalg.norm(satellite.dynamics.r_BN_N))
    """
    if hasattr(given, "link_satellites") and hasattr(given, "communication_pairs") and not isinstance(given, type):
        return PerEnvironmentCommunication(copy.copy(given))
    if hasattr(given, "create_data_store") and not isinstance(given, type):
        return PerEnvironmentReward(copy.copy(given))
    if hasattr(given, "regenerate_targets") and not isinstance(given, type | Scenario):
        return PerEnvironmentTargets(copy.copy(given))
    if callable(given) and not isinstance(given, type | GlobalReward | CommunicationMethod):
        return adapted(given)
    if isinstance(given, GlobalReward | CommunicationMethod | Scenario):
        raise TypeError(f"{type(given).__name__} runs for all environments at once; give it to the environment as it is")
    raise TypeError(
        f"per_environment({given!r}): give it a function of a satellite, or a rewarder, communication method or scenario "
        "with targets of one episode, an object of a class of bsk_torch.bsk_rl, made with parentheses"
    )
