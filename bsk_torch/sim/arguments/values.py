"""Conversion of ``sat_args`` and ``world_args`` to tensors, drawn at each reset.

A value may be a constant, a distribution of :mod:`bsk_torch.rand`, or a callable without arguments. Constants become tensors
with leading dimension 1, the others with one row for each environment being reset.

User functions may share state and NumPy's generator, so they are called apart from the rest, in :meth:`Arguments.ask`: all
of one environment before those of the next. :meth:`Arguments.draw` converts their answers, and draws all else in batches.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Container, Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
import torch
from torch import Tensor

from bsk_torch._checks import no_gradient, number, whole
from bsk_torch.astro.ephemeris import coverage, parse_utc
from bsk_torch.astro.orbit import rv_to_elements
from bsk_torch.codegen.kept import of_package
from bsk_torch.rand import Choice, Distribution, Key, PerEnv, RandomEpoch, seeded
from bsk_torch.sim.arguments.sources import Answers, Member, in_order, is_function, unknown
from bsk_torch.sim.component import Arg, Component, UserArguments, Values, asked
from bsk_torch.sim.names import nearest
from bsk_torch.vec3 import Vec3

Overrides = Mapping[str, tuple[Tensor, Tensor]]
"""Arguments that replace those of some satellites, by name: indices of the satellites [c], and their values [n, c, ...]."""

ELEMENT_NAMES = ("a", "e", "i", "Omega", "omega", "f")


def numbers(value: object) -> Tensor:
    """Return numbers, sequences, arrays, tensors, or objects with attributes a, e, i, Omega, omega and f as a float64 tensor."""
    if all(hasattr(value, name) for name in ELEMENT_NAMES):
        value = [no_gradient(f"orbital element {name}", getattr(value, name)) for name in ELEMENT_NAMES]
    if isinstance(value, list | tuple) and any(isinstance(v, Tensor) or hasattr(v, "a") for v in value):
        return torch.stack([numbers(v) for v in value])
    if isinstance(value, list | tuple) and any(isinstance(v, np.ndarray) for v in value):
        value = np.asarray(value)
    return torch.as_tensor(value, dtype=torch.float64)


def _index(arg: Arg, value: Any) -> float:
    for k, choice in enumerate(arg.choices):
        if np.shape(value) == () and (value is choice or bool(value == choice)):
            return float(k)
    raise ValueError(f"{arg.name}={value!r} must be one of {list(arg.choices)}")


def _epoch(arg: Arg, value: object) -> float:
    try:
        return parse_utc(value if isinstance(value, datetime) else str(value))
    except ValueError as error:
        raise ValueError(f"{arg.name}: {error}") from error


def _shaped(arg: Arg, values: Tensor, rows: int) -> Tensor:
    values = values.cpu()
    if arg.kind == "matrix" and values.shape[1:] == (3, 3):
        values = values.flatten(1)
    if arg.kind == "vector" and values.shape == (rows, 3, 1):
        values = values.squeeze(-1)
    if arg.spread and values.shape == (rows,) and None not in arg.dims:
        values = values.reshape(rows, *[1] * len(arg.dims)).expand(rows, *(size or 1 for size in arg.dims))
    if arg.diagonal and values.shape[1:] == arg.dims[:1]:
        values = torch.diag_embed(values)
    fits = values.ndim == 1 + len(arg.dims) and all(map(lambda size, n: n in (None, size), values.shape[1:], arg.dims))
    if len(values) != rows or not fits:
        sizes = ["any" if size is None else str(size) for size in arg.dims]
        what = f"numbers of shape [{', '.join(sizes)}]" if len(sizes) > 1 or "any" in sizes else f"{(*sizes, 1)[0]} numbers"
        what = what if sizes else "one number"
        raise ValueError(f"{arg.name} needs {what} for each environment ({arg.unit}); got shape {list(values.shape[1:])}")
    bad = torch.isnan(values) | (values < arg.low) | (values > arg.high)
    if not arg.may_be_infinite:
        bad = bad | torch.isinf(values)
    if arg.whole:
        bad = bad | (values != torch.floor(values))
    if bool(bad.any()):
        raise ValueError(f"{arg.name}={values[bad][0].item():g} {arg.unit} is not allowed; it must {arg.allowed}")
    return values


def is_orbit(value: object) -> bool:
    """Return whether a value is an orbit at an epoch: an element set or an ephemeris."""
    return hasattr(value, "state_at")


def holds_orbit(value: object) -> bool:
    """Return whether a value, or an option or row of a distribution, is an orbit at an epoch."""
    several = value.options if isinstance(value, Choice) else value.values if isinstance(value, PerEnv) else ()
    return is_orbit(value) or (isinstance(several, list | tuple) and any(map(is_orbit, several)))


def _elements_at(values: Sequence[Any], et: Tensor) -> Tensor:
    """Return osculating elements, [rows, 6], of orbits, one for each row, at ET [rows], s; other values may stand among them.

    Rows of one orbit are evaluated at once.
    """
    found = torch.empty(len(values), len(ELEMENT_NAMES), dtype=torch.float64)
    groups: dict[int, list[int]] = {}
    for row, value in enumerate(values):
        groups.setdefault(id(value), []).append(row)
    for rows in groups.values():
        value = values[rows[0]]
        if is_orbit(value):
            r, v = value.state_at(et[rows])
            found[rows] = torch.stack(rv_to_elements(Vec3.of(r), Vec3.of(v)), -1)
        else:
            found[rows] = numbers(value)
    return found


def convert(arg: Arg, values: Any, rows: int, et: Tensor | None = None) -> Any:
    """Return given values of an argument, one for each row, as a tensor [rows, ...] of its kind; ValueError for others.

    Orbits are evaluated at ET, [rows or 1] s: a single value for several epochs has as many rows as these.
    """
    no_gradient(arg.name, values)
    if arg.kind == "orbit" and isinstance(values, list) and any(map(is_orbit, values)):
        if et is None:
            raise ValueError(
                f"{arg.name}={values[0]} is an orbit at an epoch, which {arg.name} of a world without utc_init lacks"
            )
        rows = max(rows, len(et))
        values = _elements_at(values * rows if len(values) == 1 else values, et.expand(rows))
    if arg.kind == "choice":
        return torch.tensor([_index(arg, v) for v in values], dtype=torch.float64)
    if arg.kind == "utc":
        return torch.tensor([_epoch(arg, value) for value in values], dtype=torch.float64)
    try:
        numeric = numbers(values)
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        shown = values[0] if isinstance(values, list) and len(values) == 1 else values
        why = "" if isinstance(shown, str) else f": {error}"
        raise ValueError(f"{arg.name}={shown!r} must be numeric ({arg.unit}){why}") from error
    return _shaped(arg, numeric, rows)


def alike(a: Any, b: Any) -> bool:
    """Return whether two given values of an argument are equal."""
    if a is b:
        return True
    try:
        return type(a) is type(b) and np.shape(a) == np.shape(b) and bool(np.all(np.asarray(a == b)))
    except (TypeError, ValueError, RuntimeError):
        return False


def is_fixed(arg: Arg) -> bool:
    """Return whether an argument is the same for all environments and episodes, since it decides what is built."""
    return arg.shared or arg.kind in ("constant", "stations")


class Arguments:
    """Arguments of the satellites of one type, or of the world: their table, the given values, and their draws.

    Attributes:
        table: The arguments by name.
        random: Names of those that may differ between environments: they are drawn for each, or have been changed.
    """

    def __init__(
        self,
        components: Iterable[Component],
        arguments: UserArguments | Sequence[UserArguments],
        title: str,
        columns: Sequence[int] = (0,),
        as_flown: bool = False,
    ) -> None:
        """Merge the table of ``components`` with ``arguments``, of all satellites of an environment or of each of them.

        ``title`` is what the user calls the dictionary; draws depend on ``columns``, the numbers of the satellites within an
        environment. Bounds ``as_flown`` are those of what Basilisk takes, see :class:`~bsk_torch.sim.component.Arg`. KeyError
        for an unknown name.
        """
        self.as_flown = as_flown
        self.title, self.columns = title, tuple(columns)
        self.owners = tuple(columns) if title == "sat_args" else (title,)
        self.table = self._bounded(arg for component in components for arg in component.args)
        each = [arguments] if isinstance(arguments, Mapping) else list(arguments)
        merged = [self._merged(values) for values in each]
        self._given = [dict(merged[0]) for _ in columns] if isinstance(arguments, Mapping) else merged
        self._of_envs: list[dict[str, dict[int, object]]] = [{} for _ in self._given]
        self._changed: set[str] = set()
        self._look()

    def of_components(
        self, components: Iterable[Component], arguments: Mapping[str, object] | Sequence[Mapping[str, object]]
    ) -> Arguments:
        """Return the arguments that other components of the same slots declare: their shapes and defaults may differ.

        A given value that is the very default of an argument that differs now, from a copy of all defaults, becomes the new one.
        """
        components = tuple(components)
        other = self._bounded(arg for component in components for arg in component.args)
        old = {name: arg.default for name, arg in self.table.items() if other.get(name) != arg}
        if not old and other.keys() == self.table.keys():
            return self

        def wanted(values: Mapping[str, object]) -> dict[str, object]:
            return {name: value for name, value in values.items() if name not in old or value is not old[name]}

        renewed = wanted(arguments) if isinstance(arguments, Mapping) else [wanted(values) for values in arguments]
        return Arguments(components, renewed, self.title, self.columns, self.as_flown)

    def _bounded(self, args: Iterable[Arg]) -> dict[str, Arg]:
        return {arg.name: arg.as_flown if self.as_flown else arg for arg in args}

    def _merged(self, arguments: UserArguments) -> dict[str, object]:
        for name in arguments:
            if name not in self.table:
                raise KeyError(unknown(self.title, name, self.table))
            if isinstance(arguments[name], type) and issubclass(arguments[name], Distribution):
                raise ValueError(
                    f"{self.title}: {name}={arguments[name].__name__} is a class; write an object of it, with parentheses"
                )
        merged = {name: arguments.get(name, arg.default) for name, arg in self.table.items()}
        replaced = {"rN", "vN"} & {name for name in arguments if arguments[name] is not None}
        if replaced and "oe" not in arguments and "oe" in merged:
            merged["oe"] = None  # an explicit position replaces the default elements
        if is_orbit(merged.get("oe")) and merged["mu"] not in (None, self.table["mu"].default):
            raise ValueError(f"{self.title}: mu={merged['mu']} converts elements that are numbers; oe={merged['oe']} has states")
        for name, value in merged.items():
            if isinstance(value, Member) and is_fixed(self.table[name]):
                merged[name] = value.trial
        return merged

    def _look(self) -> None:
        """Find out which arguments are random, equal for all satellites, and asked of functions; forget constants."""
        self._constants: dict[str, Any] = {}
        drawn = [
            {n for n, v in values.items() if isinstance(v, Distribution) or callable(v) or is_orbit(v)} for values in self._given
        ]
        self.random = frozenset(self._changed.union(*drawn))
        apart = {name for of_envs in self._of_envs for name in of_envs}
        self._asked = [
            in_order(name for name in self.table if any(map(is_function, self._values_of(k, name))))
            for k in range(len(self._given))
        ]
        apart |= {name for names in self._asked for name in names if not is_fixed(self.table[name])}
        self._alike = {
            name: name not in apart and all(alike(values[name], self._given[0][name]) for values in self._given[1:])
            for name in self.table
        }

    def _values_of(self, k: int, name: str) -> list[object]:
        return [self._given[k][name], *self._of_envs[k].get(name, {}).values()]

    @property
    def given(self) -> dict[str, Any]:
        """Values of the first satellite; the ones that models are built from are the same for all."""
        return self._given[0]

    @property
    def calls_user(self) -> bool:
        """Whether a user function is called for each episode."""
        return any(self._asked)

    # -- changes ------------------------------------------------------------------------------------------------------

    def changed(self, changes: Iterable[tuple[int, str, object, Sequence[int] | None]]) -> Arguments:
        """Return arguments with other values; these remain unchanged.

        A change has the index of a satellite within the type, a name, a value, and the environments that get it, None for all.
        KeyError for an unknown name, ValueError for an argument that decides what is built.
        """
        new = copy.copy(self)
        new._given, new._changed = [dict(values) for values in self._given], set(self._changed)
        new._of_envs = [{name: dict(values) for name, values in each.items()} for each in self._of_envs]
        for k, name, value, envs in changes:
            if name not in self.table:
                raise KeyError(unknown(self.title, name, self.table))
            if is_fixed(self.table[name]):
                raise ValueError(
                    f"{self.title}: {name} decides what is built, so it cannot be changed between episodes; "
                    "build another environment"
                )
            new._changed.add(name)
            if envs is None:
                new._given[k][name] = value
                new._of_envs[k].pop(name, None)
            elif value is new._given[k][name]:
                remaining = {env: mine for env, mine in new._of_envs[k].pop(name, {}).items() if env not in envs}
                new._of_envs[k] |= {name: remaining} if remaining else {}
            else:
                new._of_envs[k].setdefault(name, {}).update(dict.fromkeys(envs, value))
        new._look()
        return new

    def of_first(self) -> Arguments:
        """Return the arguments of the first satellite alone."""
        new = copy.copy(self)
        new.columns, new.owners, new._given, new._of_envs = self.columns[:1], self.owners[:1], self._given[:1], self._of_envs[:1]
        new._look()
        return new

    # -- drawing ------------------------------------------------------------------------------------------------------

    def value(self, k: int, name: str, env: int) -> Any:
        """Return the given value of satellite k of the type in the environment ``env``."""
        return self._of_envs[k].get(name, {}).get(env, self._given[k][name])

    def ask(self, k: int, env: int, answers: Answers) -> None:
        """Call the functions of satellite k for an episode of the environment ``env``, in order, and add what they return."""
        owner = self.owners[k]
        for name in self._asked[k]:
            value = self.value(k, name, env)
            if (owner, name) in answers or not is_function(value):
                continue
            if not isinstance(value, Member):
                answers[owner, name] = value()
                continue
            for other, answer in value.ask(self.title).items():
                if other in self.table and is_fixed(self.table[other]) and not alike(answer, self._given[k][other]):
                    first = self._given[k][other]
                    raise ValueError(
                        f"{self.title}: {other}={answer!r} was {first!r} at the function's first call; it decides what is "
                        "built, so it must be the same in all episodes"
                    )
                other_value = self.value(k, other, env) if other in self.table else value
                if isinstance(other_value, Member) and other_value.function is value.function:
                    answers[owner, other] = answer

    def _asked_alone(self, key: Key, names: Container[str]) -> list[Answers]:
        """Return the answers for each environment of a key, of all functions whose values are not known."""
        if not self.calls_user:
            return []
        answers: list[Answers] = []
        with seeded(key.named(self.title)) as rows:
            for row in rows:
                answers.append({(owner, name): None for owner in self.owners for name in self.table if name in names})
                for k in range(len(self.owners)):
                    self.ask(k, int(row.env_id), answers[-1])
        return answers

    def draw(
        self,
        key: Key,
        known: Mapping[str, object] | None = None,
        answers: Sequence[Answers] | None = None,
        et: Tensor | None = None,
    ) -> Values:
        """Return the values of all arguments for the n environments of ``key``: [1, ...] if all are equal, else [n * S, ...].

        Arguments that are ``known`` already are not drawn again. ``answers`` are those of the user's functions for each
        environment; by default, the functions are called now. Orbits are evaluated at ``et``, [n or 1] s.
        """
        known = known or {}
        answers = self._asked_alone(key, known) if answers is None else answers
        drawn = self._draw_named([name for name in self.table if name not in known], key, answers, et)
        return {name: known[name] if name in known else drawn[name] for name in self.table}

    def draw_per_env(self, key: Key, et: Tensor | None = None) -> dict[str, Any]:
        """Return the values, [n * S, ...], of the arguments that ``rand.per_env`` gives: the same in all episodes.

        Those that user functions give to some satellites or environments are left out. Orbits are those at ``et``, [n or 1] s.
        """
        values = {name: [value for k in range(len(self._given)) for value in self._values_of(k, name)] for name in self.table}
        names = [name for name, of in values.items() if any(isinstance(x, PerEnv) for x in of) and not any(map(is_function, of))]
        return self._draw_named(names, key, (), et)

    def draw_some(self, names: Sequence[str], key: Key) -> dict[str, Any]:
        """Return the values of the arguments ``names``, as :meth:`draw` returns them; of functions, only theirs are called."""
        return self._draw_named(names, key, self._asked_alone(key, self.table.keys() - set(names)))

    def _draw_named(
        self, names: Iterable[str], key: Key, answers: Sequence[Answers], et: Tensor | None = None
    ) -> dict[str, object]:
        rows = key if self.columns == (0,) else key.of_satellites(torch.tensor(self.columns))
        return {name: self._drawn_or_kept(self.table[name], key, rows, answers, et) for name in names}

    def override(self, name: str, values: Tensor | None, columns: Tensor, given: Tensor) -> Tensor:
        """Return drawn values of an argument, or None, with those of some satellites replaced, [n * S, ...].

        ``given`` [n, c, ...] are the values of the satellites ``columns`` [c] of the type. KeyError for an unknown name,
        ValueError for values that are not allowed, or if only some satellites have one.
        """
        if name not in self.table:
            raise KeyError(f"sat_arg_randomizer sets {name!r}, which is unknown; {nearest(name, self.table)}")
        arg, (n, c), s = self.table[name], given.shape[:2], len(self.columns)
        new = convert(arg, given.flatten(0, 1), n * c).unflatten(0, (n, c))
        if c < s and values is None:
            raise ValueError(f"sat_arg_randomizer sets {name} of some satellites of a type; the others need one in sat_args")
        whole = new.new_empty(n, s, *new.shape[2:]) if values is None else values.expand(n * s, *new.shape[2:])
        whole = whole.reshape(n, s, *new.shape[2:]).clone()
        whole[:, columns] = new
        return whole.flatten(0, 1)

    def _drawn_or_kept(self, arg: Arg, key: Key, rows: Key, answers: Sequence[Answers], et: Tensor | None) -> object:
        value = self.given[arg.name]
        if not self._alike[arg.name]:
            return self._drawn_each(arg, key, answers, et)
        if isinstance(value, Distribution) or is_orbit(value):
            each = None if et is None else et.expand(len(key)).repeat_interleave(len(self.columns))
            return self._draw(arg, value, rows, et=each)
        if arg.name not in self._constants:
            self._constants[arg.name] = self._draw(arg, value, key)
        kept = self._constants[arg.name]
        return kept.expand(len(rows), *kept.shape[1:]) if arg.name in self._changed and isinstance(kept, Tensor) else kept

    def _drawn_each(self, arg: Arg, key: Key, answers: Sequence[Answers], et: Tensor | None) -> object:
        """Return the values of an argument given for each satellite, [n * S, ...]."""
        if is_fixed(arg):
            raise ValueError(f"{self.title}: {arg.name} must be the same for all satellites of a type")
        table = self._constants.get(arg.name)
        if table is None:
            table = self._each(arg, key, answers, et)
            if arg.name not in self.random:
                self._constants[arg.name] = table
        return None if table is None else table.expand(len(key), *table.shape[1:]).flatten(0, 1)

    def _each(self, arg: Arg, key: Key, answers: Sequence[Answers], et: Tensor | None) -> Tensor | None:
        """Return the values of an argument, [n or 1, S, ...]; None if no satellite has one."""
        parts = [self._of_satellite(k, arg, key, answers, et) for k in range(len(self._given))]
        missing = [part is None for part in parts]
        if all(missing):
            return None
        if any(missing):
            raise ValueError(f"{self.title}: {arg.name} must be given for all satellites of a type, or for none")
        shapes = [list(part.shape[1:]) for part in parts]
        if any(shape != shapes[0] for shape in shapes):
            raise ValueError(f"{self.title}: {arg.name} has values of shapes {shapes}; all satellites of a type need the same")
        n = max(len(part) for part in parts)
        return torch.stack([part.expand(n, *part.shape[1:]) for part in parts], 1)

    def _of_satellite(self, k: int, arg: Arg, key: Key, answers: Sequence[Answers], et: Tensor | None) -> Any:
        """Return the values of an argument of one satellite, [n or 1, ...]; None if it has none."""
        satellite_key = key.of_satellites(torch.tensor([self.columns[k]]))
        asked = [answer.get((self.owners[k], arg.name)) for answer in answers]
        value, of_envs = self._given[k][arg.name], self._of_envs[k].get(arg.name)
        if not of_envs:
            return self._draw(arg, value, satellite_key, asked, et)
        groups: dict[int, tuple[Any, list[int]]] = {}
        for row, env in enumerate(key.env_id.tolist()):
            env_value = of_envs.get(env, value)
            groups.setdefault(id(env_value), (env_value, []))[1].append(row)
        parts: list[tuple[Tensor, list[int]]] = []
        for env_value, rows in groups.values():
            then = None if et is None else et.expand(len(key))[rows]
            part = self._draw(arg, env_value, satellite_key.take(rows), [asked[row] for row in rows] if asked else asked, then)
            if part is None:
                raise ValueError(f"{self.title}: {arg.name} must be given for all environments, or for none")
            parts.append((part, rows))
        whole = torch.empty(len(key), *parts[0][0].shape[1:], dtype=torch.float64)
        for part, rows in parts:
            if part.shape[1:] != whole.shape[1:]:
                raise ValueError(
                    f"{self.title}: {arg.name} has values of shapes {[list(p.shape[1:]) for p, _ in parts]} in different "
                    "environments; all of a type must have the same"
                )
            whole[rows] = part.expand(len(rows), *part.shape[1:])
        return whole

    def _draw(self, arg: Arg, value: object, key: Key, asked: Sequence[object] = (), et: Tensor | None = None) -> Any:
        try:
            if is_fixed(arg):
                self._check_shared(arg, value)
            if arg.kind in ("constant", "stations"):
                return value
            if isinstance(value, RandomEpoch) and arg.kind == "utc":
                of_arg, (first, last) = key.named(arg.name), coverage()
                drawn = value.draw_et(of_arg)  # words, which take longer to read, only for the error
                inside = bool(((first <= drawn) & (drawn <= last)).all())
                return drawn if inside else convert(arg, value.draw(of_arg), len(key))
            if isinstance(value, Distribution):
                return convert(arg, value.draw(key.named(arg.name)), len(key), et)
            if callable(value):
                return convert(arg, [drawn_once(arg, answer, key, row) for row, answer in enumerate(asked)], len(key), et)
            if value is None and arg.kind != "choice":
                return self._missing(arg)
            return convert(arg, [value], 1, et)
        except ValueError as error:
            raise ValueError(f"{self.title}: {error}") from error

    @staticmethod
    def _check_shared(arg: Arg, value: object) -> None:
        if isinstance(value, Distribution) or callable(value):
            raise ValueError(f"{arg.name}={value!r} must be the same for all environments; give a constant")
        if arg.kind == "stations":
            _check_stations(value)
        if arg.kind == "constant" and arg.choices:
            _index(arg, value)

    @staticmethod
    def _missing(arg: Arg) -> Tensor | None:
        if arg.missing is None:
            if arg.default is not None and arg.name != "oe":
                raise ValueError(f"{arg.name}=None is not allowed; give {arg.doc} in {arg.unit}")
            return None
        return torch.full((1, *(size or 1 for size in arg.dims)), arg.missing, dtype=torch.float64)


def drawn_once(arg: Arg, answer: object, key: Key, row: int) -> object:
    """Return the value of a function's answer for one row of a key; a distribution is drawn."""
    return answer.draw(key.take([row]).named(arg.name))[0] if isinstance(answer, Distribution) else answer


STATION_BOUNDS = {
    "lat": (-90.0, 90.0),
    "long": (-360.0, 360.0),
    "elev": (-1e4, 1e7),
    "groundLocationPlanetRadius": (1e-9, 1e9),
    "gsMinimumElevation": (-math.pi / 2, math.pi / 2),
    "gsMaximumRange": (-math.inf, math.inf),
}
"""Bounds of the numbers of a station, degrees for latitude and longitude, else m and rad."""

STATION_KEYS = (*STATION_BOUNDS, "antennas", "name")


def _check_stations(stations: object) -> None:
    if isinstance(stations, str | Mapping) or not isinstance(stations, Sequence):
        raise ValueError(f"groundStationsData={stations!r} must be a list of stations, such as {{'lat': 40.0, 'long': -105.2}}")
    if not stations:
        raise ValueError("groundStationsData is empty; it needs at least one station, such as {'lat': 40.0, 'long': -105.2}")
    for station in stations:
        if not isinstance(station, Mapping):
            raise ValueError(f"groundStationsData holds {station!r}; a station is a dictionary, {{'lat': 40.0, 'long': -105.2}}")
        for key, value in station.items():
            if key not in STATION_KEYS:
                raise ValueError(f"groundStationsData has an unknown key {key!r}; {nearest(str(key), STATION_KEYS)}")
            if key == "antennas" and value:
                whole("groundStationsData: antennas", value, 1)
            if key in STATION_BOUNDS and key not in ("lat", "long") and value:  # a falsy value is an unset one
                number(f"groundStationsData: {key}", value, *STATION_BOUNDS[key], finite=key != "gsMaximumRange")
        for key in ("lat", "long"):
            bound = STATION_BOUNDS[key][1]
            if not isinstance(station.get(key), int | float) or not -bound <= station[key] <= bound:
                raise ValueError(f"groundStationsData needs {key!r} in degrees within +-{bound:g}; got {station}")


def merge(values: Values, components: Sequence[Component], what: str) -> dict[str, Tensor]:
    """Return all that the components' functions ``what``, ``initial`` or ``prepare``, compute from the values, by name.

    Fields of the state that no component gives a value are zero. TypeError or ValueError for a user's function that returns
    other names, or no number for a parameter.
    """
    merged: dict[str, Tensor] = {}
    user_slots: dict[str, str] = {}  # slots of users' components by what they have returned
    for component, share in asked([part for part in components if getattr(part, what) is not None], values):
        function = getattr(component, what)
        computed, is_own = function(share), not of_package([function])
        if is_own:
            _check_computed(component, what, computed, values, merged)
        for name in computed.keys() & (merged if is_own else user_slots).keys():
            raise ValueError(
                f"{what}(args) of the component in slot {user_slots.get(name, component.slot)!r} returns {name!r}, which another "
                "component returns, too; give the field another name"
            )
        user_slots.update(dict.fromkeys(computed if is_own else (), component.slot))
        merged.update(computed)
    for field in (field for component in components for field in component.state) if what == "initial" else ():
        if field.name not in merged:
            merged[field.name] = torch.zeros(1, field.width, dtype=torch.float64)
    return merged


def _check_computed(component: Component, what: str, computed: object, values: Values, others: Container[str]) -> None:
    """Check what a user's component computes when episodes start; ``others`` are values of the components before it."""
    fields = {field.name: field for field in (component.state if what == "initial" else component.params)}
    entry = "state" if what == "initial" else "params"
    title = f"{what}(args) of the component in slot {component.slot!r}"
    if not isinstance(computed, Mapping):
        raise TypeError(f"{title} returns {computed!r}; it must return a dictionary of float64 tensors by the names in {entry}=")
    for name in computed:
        if name not in fields:
            raise ValueError(f"{title} returns {name!r}, which is not in {entry}= of the component; {nearest(str(name), fields)}")
    rows = max((len(value) for value in values.values() if isinstance(value, Tensor)), default=1)
    for name, field in fields.items():
        if name not in computed:
            if name in others or what == "initial":
                continue
            raise ValueError(f"{title} lacks {name!r}, which {entry}= of the component lists")
        value, width = computed[name], field.width
        shapes = [(n, width) for n in (1, rows)] + [(n,) for n in (1, rows) if width == 1]
        if not isinstance(value, Tensor) or (value.shape not in shapes and not (value.ndim > 2 and value[0].numel() == width)):
            description = f"of shape {list(value.shape)}" if isinstance(value, Tensor) else repr(value)
            wanted = f"[1, {width}] or [{rows}, {width}]" if width > 1 else f"[1] or [{rows}]"
            raise TypeError(f"{title}[{name!r}] is {description}; it must be a float64 tensor of shape {wanted}")
        if bool(torch.isnan(value).any()):
            raise ValueError(
                f"{title}[{name!r}] is NaN in row {int(torch.isnan(value).view(len(value), -1).any(1).int().argmax())}"
            )
