"""Files that others may have made: the one door for JSON, YAML, compressed bytes, archives of torch, and memory-mapped data.

Nothing in such a file is executed. Sizes, shapes and depths are compared with bounds before anything is allocated, so that a
small file costs little memory and time. Whatever is wrong with a file is a ValueError with the reason, to which readers add the
name of the file.
"""

from __future__ import annotations

import functools
import io
import itertools
import json
import zipfile
import zlib
from collections.abc import Hashable, Iterator, Mapping
from math import isfinite
from pathlib import Path
from reprlib import repr as _short
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar, cast

import torch
from annotated_types import Interval, Predicate
from torch import Tensor

from bsk_torch._text import visible
from bsk_torch.sim.names import nearest

Schema = TypeVar("Schema")

MOST_JSON = 2**24
"""Largest JSON file, bytes."""

MOST_YAML, DEEPEST_YAML = 2**18, 20
"""Most values in a YAML file, and the most levels at which they are nested."""

MOST_ERRORS = 1000
"""Wrong entries from which on a message names none."""

Word = Annotated[str, Predicate(str.isprintable)]
"""Text that is shown: nothing in it moves the cursor or changes the colors of a terminal."""

Count = Annotated[int, Interval(ge=0, le=2**62)]
"""A number of things, or a seed."""

if TYPE_CHECKING:
    from tensordict import TensorDict

    Json = Any
else:

    class Json:
        """The content of a JSON file: finite numbers, whole ones of 64 bits."""

        @classmethod
        def __get_pydantic_core_schema__(cls, source: object, handler: object) -> object:
            from pydantic import AfterValidator, JsonValue

            return handler(Annotated[JsonValue, AfterValidator(_checked_numbers)])


class NotRead:
    """Annotation of a dataclass's field that no file has."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: object) -> object:
        from pydantic_core import core_schema

        return core_schema.none_schema()


TORCH_TYPES = {str(kind): kind for kind in vars(torch).values() if isinstance(kind, torch.dtype)}


def _checked_numbers(value: object) -> object:
    """Return what JSON holds; ValueError for a number that is not finite, or a whole one of more than 64 bits."""
    stack = [value]
    while stack:
        part = stack.pop()
        if isinstance(part, dict):
            stack += part.values()
        elif isinstance(part, list):
            stack += part
        elif isinstance(part, int | float) and not -(2**63) <= part < 2**63 and (isinstance(part, int) or not isfinite(part)):
            raise ValueError(f"it holds the number {_short(part)}, which is not finite, or has more than 64 bits")
    return value


# -- JSON ---------------------------------------------------------------------------------------------------------------------


def read_json(path: Path | str, schema: type[Schema], wrong: str, most: int = MOST_JSON) -> Schema:
    """Return the content of a JSON file.

    Args:
        path: The file.
        schema: Type of the content: a dataclass, a TypedDict, :data:`Json`, or a container of these, as Pydantic reads it.
        wrong: What a file is that does not fit, for the message, such as ``"is no catalog"``.
        most: Largest size, bytes.

    Raises:
        OSError: If it cannot be read.
        ValueError: For any other content; the message names the file and the first wrong entry.
    """
    try:
        return parse_json(read_bytes(path, most), schema)
    except ValueError as error:
        raise ValueError(f"{str(path)!r} {wrong}: {error}") from None


def parse_json(content: bytes, schema: type[Schema]) -> Schema:
    """Return JSON as a ``schema``; ValueError for other content, for numbers that are not finite, and for deep nesting.

    Values are not converted, except whole numbers to real ones. Pydantic nests 200 levels deep at most.
    """
    from pydantic import ValidationError

    try:
        return _root(cast(Hashable, schema)).model_validate_json(content).root
    except ValidationError as error:
        raise ValueError(one_line(_reason(error))) from None


@functools.cache
def _root(schema: Any) -> Any:
    """Return the model of a file; its configuration applies to the dataclasses in it, too."""
    from pydantic import ConfigDict, RootModel

    settings = {"model_config": ConfigDict(strict=True, allow_inf_nan=False), "__module__": __name__}
    return type("File", (RootModel[schema],), settings)


def _reason(error: Any) -> str:
    """Return the first error of a validation in one line: entry, value, and what is allowed."""
    if error.error_count() > MOST_ERRORS:
        return f"{error.error_count():,} of its entries are wrong"  # details of so many would need much memory
    first = error.errors(include_url=False)[0]
    place, value = first["loc"], first["input"]
    if first["type"] == "missing":
        where = f"{_place(place[:-1])} lacks" if place[:-1] else "it lacks"
        return f"{where} {place[-1]!r}; {nearest(str(place[-1]), value if isinstance(value, Mapping) else ())}"
    sentence = first["msg"].removeprefix("Value error, ")
    if first["type"] in ("value_error", "json_invalid"):
        return f"{_place(place)}: {sentence}" if place else sentence
    return f"{_place(place) or 'its content'}={_short(value)}: {sentence}"


def one_line(text: str) -> str:
    """Return a message with parts of a file on one line, without characters that control a terminal."""
    return visible(text.partition("\n")[0], keep="")


def _place(parts: tuple[int | str, ...]) -> str:
    """Return a path such as ``satellites[1].mass``."""
    names = (f".{part}" if isinstance(part, str) and part.isidentifier() else f"[{part!r}]" for part in parts)
    return "".join(names).removeprefix(".")


# -- YAML ---------------------------------------------------------------------------------------------------------------------


class Node(NamedTuple):
    """A value in YAML: its line, counted from 1, and the number, text or None, or the nodes in it."""

    line: int
    value: object


def parse_yaml(content: bytes, schema: type[Schema]) -> Schema:
    """Return YAML as a ``schema``, likewise; ValueError with the line, see :func:`read_yaml`."""
    from pydantic import ValidationError

    node = read_yaml(content)
    try:
        return _root(cast(Hashable, schema)).model_validate_json(json.dumps(plain(node))).root
    except ValidationError as error:
        first = error.errors(include_url=False)[0]["loc"] if error.error_count() <= MOST_ERRORS else ()
        raise ValueError(one_line(f"line {_line(node, first)}: {_reason(error)}")) from None


def read_yaml(content: bytes, *, typed: bool = True, most: int = MOST_YAML) -> Node:
    """Return the content of a file in YAML.

    Keys are text and occur once. Times without quotes are text; all values but None are, unless they are ``typed``.
    ValueError, with the line, for other content, for anchors, aliases and tags, and for more than ``most`` values or
    :data:`DEEPEST_YAML` levels.
    """
    import yaml

    try:
        return _YamlReader(content, typed, most).document()
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ValueError(one_line(f"{line}{error.problem or error}")) from None
    except yaml.YAMLError as error:
        raise ValueError(one_line(str(error))) from None


class _YamlReader:
    """Reads YAML from its events, so that it is checked before it is built."""

    def __init__(self, content: bytes, typed: bool, most: int) -> None:
        import yaml

        self.yaml, self.typed, self.most, self.count = yaml, typed, most, 0
        self.constructor, self.resolver = yaml.constructor.SafeConstructor(), yaml.resolver.Resolver()
        self.events = yaml.parse(content, getattr(yaml, "CSafeLoader", yaml.SafeLoader))

    def document(self) -> Node:
        outside = self.yaml.StreamStartEvent, self.yaml.DocumentStartEvent
        first = next(event for event in self.events if not isinstance(event, outside))
        if isinstance(first, self.yaml.StreamEndEvent):
            return Node(1, None)
        node, _ = self.node(first, 1), next(self.events)
        following = next(self.events)
        if not isinstance(following, self.yaml.StreamEndEvent):
            raise ValueError(f"line {following.start_mark.line + 1}: it has a second document")
        return node

    def node(self, event: Any, level: int) -> Node:
        yaml, line = self.yaml, event.start_mark.line + 1
        self.count += 1
        if self.count > self.most or level > DEEPEST_YAML + isinstance(event, yaml.ScalarEvent):
            raise ValueError(f"line {line}: it has more than {self.most:,} values, or more than {DEEPEST_YAML} levels")
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise ValueError(f"line {line}: it has anchors or aliases of YAML; values are literal")
        if event.tag is not None:
            raise ValueError(f"line {line}: it has the tag {event.tag!r:.80} of YAML; values are literal")
        if isinstance(event, yaml.ScalarEvent):
            return Node(line, self.scalar(event))
        if isinstance(event, yaml.SequenceStartEvent):
            parts = iter(lambda: next(self.events), None)
            ends = yaml.SequenceEndEvent
            return Node(
                line, [self.node(part, level + 1) for part in itertools.takewhile(lambda e: not isinstance(e, ends), parts)]
            )
        values: dict[str, Node] = {}
        while not isinstance(key := next(self.events), yaml.MappingEndEvent):
            name = self.node(key, level + 1)
            if not isinstance(key, yaml.ScalarEvent) or key.value in values:
                raise ValueError(
                    f"line {name.line}: the key {_short(getattr(key, 'value', name.value))} is no text, or there twice"
                )
            values[key.value] = self.node(next(self.events), level + 1)
        return Node(line, values)

    def scalar(self, event: Any) -> object:
        tag = self.resolver.resolve(self.yaml.ScalarNode, event.value, event.implicit)
        is_text = tag.endswith((":str", ":timestamp", ":value", ":merge"))
        if is_text or not (self.typed or tag.endswith(":null")):
            return event.value
        return self.constructor.construct_object(self.yaml.ScalarNode(tag, event.value))


def plain(node: Node) -> object:
    """Return the value of a node in dictionaries and lists."""
    if isinstance(node.value, dict):
        return {key: plain(part) for key, part in node.value.items()}
    return [plain(part) for part in node.value] if isinstance(node.value, list) else node.value


def _line(node: Node, place: tuple[int | str, ...]) -> int:
    """Return the line of the entry at ``place``, or of the innermost part around it that exists."""
    for part in place:
        try:
            node = cast(Any, node.value)[part]
        except (KeyError, IndexError, TypeError):
            break
    return node.line


# -- bytes --------------------------------------------------------------------------------------------------------------------


def read_bytes(path: Path | str, most: int) -> bytes:
    """Return the content of a file; ValueError if it has more than ``most`` bytes."""
    with open(path, "rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"it has more than {most:,} bytes")
    return content


def gunzip(content: bytes, most: int) -> bytes:
    """Return unpacked bytes, ``most`` of them at most.

    Raises:
        EOFError: If the content is cut off.
        ValueError: If it is no gzip stream, damaged, or longer.
    """
    stream = zlib.decompressobj(zlib.MAX_WBITS | 16)
    try:
        raw = stream.decompress(content, most + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    if len(raw) > most:
        raise ValueError(f"it unpacks to more than {most:,} bytes")
    if not stream.eof:
        raise EOFError
    if stream.unused_data:
        raise ValueError("something follows its end")
    return raw


# -- tensors ------------------------------------------------------------------------------------------------------------------


def read_tensors(content: bytes, entry: str | None = None, device: torch.device | str = "cpu") -> tuple[object, bytes | None]:
    """Return what ``torch.save`` has put into an archive, and the bytes of another ``entry`` of it, None without one.

    Tensors are plain ones, and together not larger than the archive. ValueError for anything else; nothing is executed.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(part.file_size for part in archive.infolist()) > len(content):
                raise ValueError("its archive unpacks to more than its own size")
            damaged = archive.testzip()  # torch does not check the checksums of entries
            if damaged is not None:
                raise ValueError(f"{damaged} is damaged")
            other = archive.read(entry) if entry in archive.namelist() else None
        values = torch.load(io.BytesIO(content), weights_only=True, map_location=device)
        total = 0
        for tensor in _tensors(values):
            if type(tensor) not in (Tensor, torch.nn.Parameter) or tensor.layout != torch.strided or tensor.is_quantized:
                raise ValueError("it holds a tensor that is not a plain one")
            total += tensor.numel() * tensor.element_size()
        if total > len(content):
            raise ValueError(f"its tensors have {total:,} bytes, and it has {len(content):,}")
    except Exception as error:  # bytes of others may raise any exception within zipfile, torch and pickle
        reason = one_line(str(error)).partition(". ")[0]  # torch says much more
        raise ValueError(reason or type(error).__name__) from error
    return values, other


def _tensors(values: object) -> Iterator[Tensor]:
    """Yield the tensors in nested dictionaries, lists, tuples and sets; parts that are there twice are walked once."""
    stack, visited = [values], set[int]()
    while stack:
        part = stack.pop()
        if id(part) in visited and not isinstance(part, Tensor):
            continue
        visited.add(id(part))
        if isinstance(part, Tensor):
            yield part
        elif isinstance(part, Mapping):
            stack += [*part.keys(), *part.values()]
        elif isinstance(part, list | tuple | set | frozenset):
            stack += part


# -- memory-mapped tensordicts ------------------------------------------------------------------------------------------------

META, TENSORDICT = "meta.json", "<class 'tensordict._td.TensorDict'>"
"""File that lists the entries in each folder of a tensordict, and the only class that is read."""


def read_memmap(folder: Path) -> TensorDict:
    """Return a memory-mapped tensordict of tensors.

    Its lists of entries are checked before tensordict reads them: nothing is unpickled, and every file is as large as its shape
    says, so that none is extended. ValueError for anything else; the message names the folder.
    """
    from tensordict import TensorDict  # which takes long to import

    try:
        _check_memmap(folder, ())
        return TensorDict.load_memmap(folder, allow_pickle=False)
    except Exception as error:  # files of others may raise any exception within tensordict
        reason = one_line(str(error))
        raise ValueError(f"{str(folder)!r} is no folder of tensors: {reason or type(error).__name__}") from error


def _check_memmap(folder: Path, batch: tuple[int, ...]) -> None:
    """Raise ValueError unless a folder holds a tensordict of tensors, all of whose shapes begin with ``batch``."""
    from tensordict._utils_key_json import _encode_key_for_filesystem  # how tensordict names its files

    meta = parse_json(read_bytes(folder / META, MOST_JSON), dict[str, Json])
    kind, device, shape = meta.pop("_type", None), meta.pop("device", None), _shape(meta.pop("shape", None), batch)
    if kind != TENSORDICT or device not in ("cpu", "None", None):
        raise ValueError(f"it holds a {kind!r:.80} on {device!r:.80}; only tensordicts on the CPU are read")
    nested = []
    for name, entry in meta.items():
        path = folder / _encode_key_for_filesystem(name)
        if entry == {"type": "TensorDict"}:
            nested.append(path)
            continue
        if not isinstance(entry, dict) or entry.get("dtype") not in TORCH_TYPES or entry.get("is_nested"):
            raise ValueError(f"its entry {name!r:.80} is no tensor")
        dims = _shape(entry.get("shape"), shape)
        size = TORCH_TYPES[str(entry["dtype"])].itemsize
        for length in dims:
            size *= length
        file = path.with_name(f"{path.name}.memmap")
        stored = file.stat().st_size if file.is_file() else 0
        if size != stored:
            raise ValueError(f"its entry {name!r:.80} of shape {_short(dims)} has {stored:,} bytes instead of {_short(size)}")
        if not size and all(shape):
            raise ValueError(f"its entry {name!r:.80} of shape {_short(dims)} is empty")
    for path in nested:
        _check_memmap(path, shape)
    if not meta:
        raise ValueError("it has no entries")


def _shape(value: object, first: tuple[int, ...]) -> tuple[int, ...]:
    """Return a shape that begins with ``first``; ValueError for anything else."""
    good = isinstance(value, list) and all(isinstance(length, int) and length >= 0 for length in value)
    if not good or tuple(value[: len(first)]) != first:  # type: ignore[index]
        raise ValueError(f"the shape {_short(value)} is no list of lengths that begins with {list(first)}")
    return tuple(value)  # type: ignore[arg-type]
