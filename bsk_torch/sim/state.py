"""The state of a batch of episodes: every tensor that belongs to an episode is declared once, in a :class:`StateTable`.

A table holds tensors whose first dimension are rows: episodes, or the satellites of one type, ``count`` of them in each episode.
Tables contain tables, so the state of an environment is a tree with one root. Resetting episodes, copying them from another
batch, saving, restoring, branching and counting bytes are one operation each, which works on rows of the whole tree. They
cover every declared tensor; all other values must be derived from the state.
"""

from __future__ import annotations

import copy
import functools
import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import torch
from torch import Tensor

from bsk_torch._checks import no_gradient, whole

if TYPE_CHECKING:
    from tensordict import TensorDict

Table = TypeVar("Table", bound="StateTable")

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

FINITE = 1e30  # bound of a field whose numbers may be any but NaN and infinities; they are finite in float32, too
SHOWN = 5  # number of wrong rows that a message lists


def outside_inference(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Decorate a function that creates state to leave inference mode, whose tensors could never be written into outside of it."""

    @functools.wraps(function)
    def outside(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        if not torch.is_inference_mode_enabled():
            return function(*args, **kwargs)
        with torch.inference_mode(False), torch.no_grad():
            return function(*args, **kwargs)

    return outside


def owned(value: Tensor) -> Tensor:
    """Return the tensor, or a writable copy if it was created in inference mode."""
    if not value.is_inference():
        return value
    with torch.inference_mode(False):
        return value.clone()


@dataclass(frozen=True)
class StateField:
    """A declared tensor [rows, *shape]."""

    name: str  # attribute of the table, and key of saved states
    initial: float | bool | None = None  # value at the start of an episode; None where the owner of the table writes it
    grows: bool = False  # whether the dimension behind the rows may become longer, filled up with `initial`
    # whether rows are the last dimension of the stored tensor, as kernels read it; saved states have them first
    planes: bool = False
    # smallest value that a saved state may hold; None for no bound. A field with a bound holds no NaN.
    low: float | None = None
    high: float | None = None  # largest one, likewise


class StateTable:
    """Declared tensors of the same rows, as attributes or items, and tables of the same episodes.

    Tensors are replaced, not written into, where a user may hold them. Large ones (``grows``, ``planes``, and those whose owner
    writes them at reset) are written in place.
    """

    num_envs: int
    """Number of episodes N."""
    count: int
    """Rows of each episode."""
    device: torch.device
    rows: int
    """Number of rows."""
    version: int
    """Number of changes; caches of queries compare it."""

    def __init__(self, num_envs: int, count: int = 1, device: torch.device | str = "cpu") -> None:
        """Make a table without fields for ``count`` rows in each of ``num_envs`` episodes."""
        attributes = self.__dict__
        attributes["num_envs"], attributes["count"], attributes["device"] = num_envs, count, torch.device(device)
        attributes["fields"], attributes["tables"], attributes["version"], attributes["rows"] = {}, {}, 0, num_envs * count

    fields: dict[str, StateField]
    tables: dict[str, StateTable]

    # -- declaring ----------------------------------------------------------------------------------------------------

    def declare(
        self,
        name: str,
        initial: float | bool | None = None,
        *shape: int,
        dtype: torch.dtype | None = None,
        grows: bool = False,
        planes: bool = False,
        low: float | None = None,
        high: float | None = None,
    ) -> None:
        """Add a tensor [rows, *shape] to the state.

        Args:
            name: Name of the tensor.
            initial: Value at the start of every episode; None where the owner writes it.
            *shape: Dimensions behind the rows.
            dtype: Type; that of ``initial`` unless given (float64 for None).
            grows: Whether the first dimension of ``shape`` may become longer.
            planes: Whether the tensor is stored as [*shape, rows].
            low: Smallest value that a restored state may hold; None for no bound. With a bound, NaN is also rejected.
            high: Largest one, likewise; :data:`FINITE` where all numbers are right.

        Raises:
            ValueError: For a name already in use, an initial value other than a number, or dimensions other than whole numbers.
        """
        if not isinstance(initial, bool | int | float | None):
            raise ValueError(f"declare({name!r}, initial={initial!r}): initial must be a number, a bool, or None")
        for dimension in shape:
            whole(f"declare({name!r}, initial, *shape): a size in shape", dimension, 0)
        if name in self.__dict__ or name in self.tables or hasattr(type(self), name):
            raise ValueError(f"name={name!r} is already declared; known are {sorted((*self.fields, *self.tables))}")
        if dtype is None:
            dtype = {bool: torch.bool, int: torch.int64}.get(type(initial), torch.float64)
        self.fields[name] = StateField(name, initial, grows, planes, low, high)
        size = (*shape, self.rows) if planes else (self.rows, *shape)
        self.__dict__[name] = owned(torch.full(size, initial or 0, dtype=dtype, device=self.device))

    def bound(self, name: str, low: float | None, high: float | None) -> None:
        """Set the smallest and the largest value that a restored state may hold in a declared field."""
        self.fields[name] = replace(self.fields[name], low=low, high=high)

    def add(self, name: str, table: StateTable) -> None:
        """Add a table of the same episodes; TypeError for something else, ValueError for a name in use or other episodes."""
        if not isinstance(table, StateTable):
            raise TypeError(f"table={table!r} must be a StateTable; declare(name, initial) adds a tensor")
        if name in self.fields or name in self.tables:
            raise ValueError(f"name={name!r} is already declared; known are {sorted((*self.fields, *self.tables))}")
        if table.num_envs != self.num_envs:
            raise ValueError(f"table {name!r} has {table.num_envs} episodes; this one has {self.num_envs}")
        self.tables[name] = table

    # -- reading and writing ------------------------------------------------------------------------------------------

    @property
    def is_empty(self) -> bool:
        """Whether the tree has no tensors."""
        return not self.fields and all(table.is_empty for table in self.tables.values())

    @property
    def all_rows(self) -> Tensor:
        """Indices of all rows."""
        return torch.arange(self.rows, device=self.device)

    def __getattr__(self, name: str) -> Any:
        names = sorted((*self.__dict__.get("fields", ()), *self.__dict__.get("tables", ())))
        raise AttributeError(f"no field of the state is called {name!r}; declared are {names}")

    def __setattr__(self, name: str, value: object) -> None:
        if isinstance(value, Tensor):
            if name not in self.fields:
                raise AttributeError(f"tensor {name!r} is not declared as part of the state; call declare({name!r}, ...) first")
            value = owned(value) if value.is_inference() else value
        self.__dict__[name] = value

    def __getitem__(self, name: str) -> Tensor:
        if name not in self.fields:
            raise KeyError(f"no field of the state is called {name!r}; declared are {sorted(self.fields)}")
        return getattr(self, name)

    def __setitem__(self, name: str, value: Tensor) -> None:
        old = self[name]
        if not isinstance(value, Tensor):
            raise TypeError(f"{name!r} of the state cannot become {value!r}; it must be a tensor of shape {list(old.shape)}")
        if value.shape != old.shape:
            raise ValueError(f"{name!r} has shape {list(old.shape)} in the state; it cannot become {list(value.shape)}")
        self.__dict__[name] = owned(value.to(old.dtype))
        self.__dict__["version"] += 1

    def put(self, **values: Tensor) -> None:
        """Replace fields by tensors of their shapes and dtypes that no user holds, made outside of inference mode."""
        self.__dict__.update(values)

    def __contains__(self, name: object) -> bool:
        return name in self.fields

    def __iter__(self) -> Iterator[str]:
        return iter(self.fields)

    def touch(self) -> None:
        """Increase ``version``: a value that queries depend on has changed."""
        self.__dict__["version"] += 1

    @property
    def nbytes(self) -> int:
        """Bytes of all tensors of the tree."""
        return sum(getattr(self, name).nbytes for name in self.fields) + sum(table.nbytes for table in self.tables.values())

    def describe(self) -> str:
        """Return a list of the state in lines of 80 characters: name, unit, smallest and largest value now, and meaning.

        Satellites list the fields of their components, with the argument of the start and the properties of the same quantity.
        """
        return "\n".join(line for name, table in self.tables.items() for line in table.described(name))

    def described(self, title: str) -> Iterator[str]:
        """Yield the lines of :meth:`describe` about this table, called ``title``, and those within."""
        if self.fields:
            yield title
        for name in self.fields:
            yield described(name, "", getattr(self, name), "")
        for name, table in self.tables.items():
            yield from table.described(f"{title}.{name}")

    # -- rows ---------------------------------------------------------------------------------------------------------

    def rows_of(self, envs: Tensor) -> Tensor:
        """Return the rows [n * count] of the episodes ``envs`` [n]."""
        if self.count == 1:
            return envs
        return (envs.unsqueeze(-1) * self.count + torch.arange(self.count, device=envs.device)).flatten()

    def reset(self, envs: Tensor) -> None:
        """Set the episodes ``envs`` [n] back to their initial values, in all tables."""
        rows = self.rows_of(envs)
        for name in self.fields:
            self._reset_field(name, rows)
        for table in self.tables.values():
            table.reset(envs)
        self.touch()

    def _reset_field(self, name: str, rows: Tensor) -> None:
        field, value = self.fields[name], getattr(self, name)
        if field.initial is None:
            return
        if field.planes:
            value[..., rows] = field.initial
        elif field.grows:
            value[rows] = field.initial
        else:
            self.__dict__[name] = value.index_fill(0, rows, field.initial)

    def copy_rows(self, envs: Tensor, other: StateTable, source: Tensor) -> None:
        """Copy the episodes ``source`` [n] of ``other`` into the episodes ``envs`` [n], in all tables.

        Fields and tables that ``other`` lacks are set back to their initial values.
        """
        rows, theirs = self.rows_of(envs), other.rows_of(source)
        for name in self.fields:
            if name in other.fields:
                self._copy_field(name, rows, getattr(other, name), theirs)
            else:
                self._reset_field(name, rows)
        for name, table in self.tables.items():
            if name in other.tables:
                table.copy_rows(envs, other.tables[name], source)
            else:
                table.reset(envs)
        self.touch()

    def _copy_field(self, name: str, rows: Tensor, value: Tensor, source: Tensor) -> None:
        field, target = self.fields[name], getattr(self, name)
        if field.planes:
            target[..., rows] = value[..., source]
        elif field.grows:
            self.write_rows(name, rows, value[source])
        elif field.initial is None:
            target[rows] = value[source]
        else:
            self.__dict__[name] = target.index_copy(0, rows, value[source])

    def repeat_rows(self, rows: Tensor, source: Tensor) -> None:
        """Copy the rows ``source`` [n] into ``rows`` [n], in this table and in those within, which have as many rows."""
        for name in self.fields:
            self._copy_field(name, rows, getattr(self, name), source)
        for table in self.tables.values():
            table.repeat_rows(rows, source)
        self.touch()

    def write_rows(self, name: str, rows: Tensor, new: Tensor) -> None:
        """Put ``new`` [n, W, ...] into ``rows`` [n] of a field that grows; the narrower one is filled up with ``initial``."""
        initial, old = self.fields[name].initial or 0.0, getattr(self, name)
        width = max(old.shape[1], new.shape[1])
        table = self.__dict__[name] = widened(old, width, initial)
        table[rows] = widened(new, width, initial)

    def taken(self: Table, envs: Tensor) -> Table:
        """Return a table of the same kind that holds copies of the episodes ``envs`` [n]."""
        return self.over(self._gathered(envs))

    def _gathered(self, envs: Tensor) -> dict[str, object]:
        values: dict[str, object] = {name: self._by_episode(name)[envs] for name in self.fields}
        return values | {name: table._gathered(envs) for name, table in self.tables.items()}

    # -- saving -------------------------------------------------------------------------------------------------------

    def to_tensordict(self) -> TensorDict:
        """Return a copy of the tree, episodes first: [N, ...], or [N, count, ...] where an episode has several rows."""
        from tensordict import TensorDict  # which takes long to import, and simulations alone do not need

        values: dict[str, object] = {name: self._by_episode(name).clone() for name in self.fields}
        values |= {name: table.to_tensordict() for name, table in self.tables.items()}
        return TensorDict(values, [self.num_envs], device=self.device)

    def _by_episode(self, name: str) -> Tensor:
        value = getattr(self, name).movedim(-1, 0) if self.fields[name].planes else getattr(self, name)
        return value if self.count == 1 else value.reshape(self.num_envs, self.count, *value.shape[1:])

    def over(self: Table, saved: Mapping[str, Any]) -> Table:
        """Return a table of the same kind over saved tensors, which are not copied; :meth:`check` checks their values.

        KeyError for missing or unknown names, TypeError for what is no table or tensor, ValueError for another shape or type,
        or a tensor that requires a gradient.
        """
        if not isinstance(saved, Mapping):
            raise TypeError(f"the saved state has {saved!r} in the place of {sorted({*self.fields, *self.tables})}")
        other = copy.copy(self)
        keys = set(saved.keys())
        if keys != {*self.fields, *self.tables}:
            missing, unknown = sorted({*self.fields, *self.tables} - keys), sorted(keys - {*self.fields, *self.tables})
            raise KeyError(f"the saved state lacks {missing} and has unknown {unknown}; it was saved by another environment")
        attributes = other.__dict__
        attributes["tables"] = {name: table.over(saved[name]) for name, table in self.tables.items()}
        for name in self.fields:
            value = saved[name]
            if not isinstance(value, Tensor) or value.ndim == 0:
                raise TypeError(f"{name!r} of the saved state is {value!r}; it must be a tensor with a row for each episode")
        numbers = {len(saved[name]) for name in self.fields} | {t.num_envs for t in other.tables.values() if not t.is_empty}
        if len(numbers) > 1:
            raise ValueError(f"tensors of the saved state have {sorted(numbers)} episodes; they must have equally many")
        attributes["num_envs"] = numbers.pop() if numbers else self.num_envs
        attributes["rows"] = attributes["num_envs"] * self.count
        for name in self.fields:
            attributes[name] = self._checked(name, saved[name])
        return other

    def _checked(self, name: str, value: Tensor) -> Tensor:
        field, current = self.fields[name], getattr(self, name)
        no_gradient(f"{name!r} of the saved state", value)
        if value.dtype != current.dtype:
            raise ValueError(f"{name!r} of the saved state has dtype {value.dtype}; it must be {current.dtype}")
        leading = 1 if self.count == 1 else 2
        behind = current.shape[:-1] if field.planes else current.shape[1:]
        wanted: list[object] = ["N", *[self.count][: leading - 1], *behind]
        if field.grows:
            wanted[leading] = "any number"
        if len(wanted) != value.ndim or any(isinstance(w, int) and w != n for w, n in zip(wanted, value.shape, strict=True)):
            form = ", ".join(map(str, wanted))
            raise ValueError(f"{name!r} of the saved state has shape {list(value.shape)}; it must be [{form}]")
        value = value if leading == 1 else value.flatten(0, 1)
        return (value.movedim(0, -1) if field.planes else value).to(self.device)

    def check(self, path: str = "") -> None:
        """Check that all values of the tree lie within the bounds of their fields, and fit together; ValueError names one.

        Subclasses check in :meth:`check_relations` what bounds cannot say. ``path`` is the place of the table in the state.
        """
        for name, field in self.fields.items():
            if field.low is not None or field.high is not None:
                value = getattr(self, name)
                wrong = torch.zeros_like(value, dtype=torch.bool)
                for bound, beyond in ((field.low, torch.lt), (field.high, torch.gt)):
                    wrong = wrong if bound is None else wrong | beyond(value, bound)
                if value.is_floating_point():
                    wrong = wrong | torch.isnan(value)
                low, high = ("" if bound is None else f"{bound:g}" for bound in (field.low, field.high))
                flat = (value, wrong) if not field.planes else (value.movedim(-1, 0), wrong.movedim(-1, 0))
                self.refuse(path + name, *flat, f"it must lie in [{low}, {high}]")
        self.check_relations(path)
        for name, table in self.tables.items():
            table.check(f"{path}{name}.")

    def check_relations(self, path: str) -> None:
        """Raise ValueError if values of saved rows do not fit together."""

    def refuse(self, name: str, value: Tensor, wrong: Tensor, why: str) -> None:
        """Raise ValueError for a saved tensor [rows, ...] that is ``wrong`` somewhere; the mask has its shape, or is [rows]."""
        rows = wrong.flatten(1).any(1) if wrong.ndim > 1 else wrong
        if bool(rows.any()):
            envs = (torch.nonzero(rows).squeeze(-1) // self.count).unique().tolist()
            worst = value[wrong].flatten()[0].item()
            raise ValueError(f"{name!r} of the saved state is {worst} in episodes {envs[:SHOWN]} ({len(envs)} in all); {why}")


def described(name: str, unit: str, value: Tensor, meaning: str) -> str:
    """Return lines of 80 characters about a tensor of the state."""
    ends = (value.min().item(), value.max().item()) if value.numel() else ()
    line = f"  {name:<22} {unit:<5} {' to '.join(f'{end:.4g}' for end in dict.fromkeys(ends)):<22}"
    return textwrap.fill(f"{line} {meaning}", 80, subsequent_indent=" " * 54, break_on_hyphens=False, replace_whitespace=False)


def widened(table: Tensor, width: int, value: float) -> Tensor:
    """Return the table [n, W, ...] with at least ``width`` columns, new ones filled with ``value``."""
    extra = width - table.shape[1]
    padding = (0, 0) * (table.ndim - 2) + (0, extra)
    return torch.nn.functional.pad(table, padding, value=value) if extra > 0 else table


def entries(table: Tensor, row: Tensor, column: Tensor) -> Tensor:
    """Return ``table[row, column]`` of a contiguous table [n, W, ...], for indices that broadcast and are not negative.

    Tables of places exceed the processor's caches; one index instead of two takes half the time.
    """
    index = row * table.shape[1] + column
    return table.flatten(0, 1).index_select(0, index.flatten()).view(*index.shape, *table.shape[2:])


def look_up(table: Tensor, place: Tensor) -> Tensor:
    """Return the entries [N, n, ...] of a table [num_envs, P, ...] for places [N, n]; each environment has N / num_envs rows."""
    flat = place.reshape(len(table), -1)
    index = flat.view(*flat.shape, *[1] * (table.ndim - 2)).expand(*flat.shape, *table.shape[2:])
    return table.gather(1, index).view(*place.shape, *table.shape[2:])
