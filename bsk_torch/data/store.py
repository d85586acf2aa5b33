"""Data that satellites collect, as objects of one satellite of one environment: the form of bsk_rl.

Environments keep tensors instead, and use these classes for rewarders in bsk_rl's form only; see
:mod:`bsk_torch.data.mapped`.
"""

from __future__ import annotations

from typing import Any, ClassVar


class Data:
    """A unit of data. Subclasses can be made without arguments, and define ``__add__``, which merges two units."""

    def __add__(self, other: Any) -> Any:
        """Return this unit and another one together."""
        raise NotImplementedError(f"{type(self).__name__} must implement __add__(other)")

    def __copy__(self) -> Any:
        """Return a new unit: an empty one and this."""
        return type(self)() + self


class DataStore:
    """The data of one satellite of one environment.

    Subclasses set ``data_type``, and define :meth:`compare_log_states`, and :meth:`get_log_state` for what it needs.

    Attributes:
        data_type: Subclass of :class:`Data`.
        satellite: The satellite.
        data: All that it knows.
        new_data: What it has collected in the last step.
        staged_data: What it has been told, and not yet merged.
    """

    data_type: ClassVar[type[Data]]

    def __init__(self, satellite: Any, initial_data: Data | None = None) -> None:
        """Begin with ``initial_data``, or with an empty unit."""
        self.satellite = satellite
        self.data: Any = self.data_type() if initial_data is None else initial_data
        self.new_data: Any = self.data_type()
        self.staged_data: list[Any] = []

    def get_log_state(self) -> Any:
        """Return what :meth:`compare_log_states` needs of the present; called after every step and at the reset."""
        return None

    def compare_log_states(self, old_state: Any, new_state: Any) -> Any:
        """Return the data of a step, from what :meth:`get_log_state` returned before and after it."""
        raise NotImplementedError(f"{type(self).__name__} must implement compare_log_states(old_state, new_state)")

    def update_from_logs(self) -> Any:
        """Merge and return the data of a step; the first call only notes the present."""
        if not hasattr(self, "log_state"):
            self.log_state = self.get_log_state()
            return self.data_type()
        before, self.log_state = self.log_state, self.get_log_state()
        self.new_data = self.compare_log_states(before, self.log_state)
        self.data += self.new_data
        return self.new_data

    def stage_communicated_data(self, external_data: Any) -> None:
        """Note what another satellite tells; it is merged when all have spoken, so that data take one hop in a step."""
        self.staged_data.append(external_data)

    def update_with_communicated_data(self) -> None:
        """Merge what has been staged."""
        for told in self.staged_data:
            self.data += told
        self.staged_data = []
