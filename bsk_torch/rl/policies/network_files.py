"""Networks in files: ONNX, ``torch.export``, and pickled modules of torch.

ONNX files and exported programs have inputs named by the environment's observations: ``observation`` [N, D] and ``action_mask``
[N, A], or the parts of named observations. They return ``action`` [N] or [N, A], or ``logits`` [N, A], of which the highest legal
one counts. Recurrent ones have the input ``memory`` and the output ``next.memory``.
"""

from __future__ import annotations

import io
import json
import pickletools
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor, nn
from torch.utils import _pytree as pytree

from bsk_torch.rl.networks.plans import MEMORY
from bsk_torch.rl.policies.interface import CONTRACT, REMEMBERED, Contract, Interface, Loaded, contract_of
from bsk_torch.untrusted import one_line, parse_json, read_tensors

RETURNED = ("action", "logits")
"""Names of outputs, the one that counts first."""

NUMBERS = {
    "tensor(float)": torch.float32,
    "tensor(double)": torch.float64,
    "tensor(bool)": torch.bool,
    "tensor(int64)": torch.int64,
}
"""Types of ONNX inputs."""

# -- ONNX ------------------------------------------------------------------------------------------------------------------------


def read_onnx(path: Path) -> Loaded:
    """Read an ONNX file; ValueError for a damaged one, or operators that ONNX Runtime lacks."""
    try:
        import onnxruntime
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("an ONNX file needs ONNX Runtime: pip install 'bsk_torch[onnx]'") from error
    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = settings.inter_op_num_threads = torch.get_num_threads()
    settings.log_severity_level = 4  # what is wrong is an error
    try:
        session = onnxruntime.InferenceSession(str(path), settings, providers=["CPUExecutionProvider"])
    except Exception as error:  # of classes of the library's C++ part
        raise ValueError(f"{str(path)!r} cannot be read as ONNX: {one_line(str(error))}") from error
    inputs, about = session.get_inputs(), session.get_modelmeta()
    title, names = f"the network of {str(path)!r}", [output.name for output in session.get_outputs()]
    for entry in inputs:
        if entry.type not in NUMBERS:
            raise ValueError(f"{title} has the input {entry.name!r} of type {entry.type}; it must be one of {', '.join(NUMBERS)}")
    returned = _returned(title, names)
    interface = Interface(
        title,
        {entry.name: _length(entry.shape) for entry in inputs},
        contract=contract_of(path, about.custom_metadata_map.get(CONTRACT)),
        memory=_memory({entry.name: entry.shape for entry in inputs}, len(returned)),
    )

    def run(parts: Sequence[Tensor]) -> list[Tensor]:
        feed = {
            entry.name: part.to(NUMBERS[entry.type]).reshape(len(part), *entry.shape[1:2]).cpu().numpy()
            if len(entry.shape) == 2 and isinstance(entry.shape[1], int)
            else part.to(NUMBERS[entry.type]).cpu().numpy()
            for entry, part in zip(inputs, parts, strict=True)
        }
        return [torch.as_tensor(result) for result in session.run([names[k] for k in returned], feed)]

    sizes = {entry.shape[0] for entry in inputs if entry.shape and isinstance(entry.shape[0], int)}
    return _loaded(interface, run, sizes, f"{about.producer_name or 'unknown'}, ONNX Runtime {onnxruntime.__version__}")


def _length(shape: Sequence[object]) -> int | None:
    """Return how many numbers an input has for each row; None if its shape does not tell."""
    sizes = [size for size in shape[1:] if isinstance(size, int)]
    return int(torch.Size(sizes).numel()) if len(sizes) == len(shape) - 1 else None


def _returned(title: str, names: Sequence[str]) -> list[int]:
    """Return the number of the output that counts, ``action``, ``logits``, or the only one, and then of a memory, if any."""
    after = [names.index(REMEMBERED)] if REMEMBERED in names else []
    for name in RETURNED:
        if name in names:
            return [names.index(name), *after]
    if len(names) != 1:
        raise ValueError(f"{title} returns {', '.join(names)}; one of them must be called action or logits")
    return [0]


def _memory(shapes: Mapping[str, Sequence[int]], returned: int) -> tuple[int, ...]:
    """Return the shape of a memory without the batch, of a network that also returns it; empty without one."""
    return tuple(shapes.get(MEMORY, ())[1:]) if returned > 1 else ()


def _loaded(interface: Interface, run: Callable[[Sequence[Tensor]], list[Tensor]], sizes: set[int], library: str) -> Loaded:
    """Return the policy of a network that runs batches, of the only one of ``sizes`` if it was exported with one."""
    if len(sizes) > 1:
        raise ValueError(f"{interface.title} has inputs with batches of {', '.join(map(str, sorted(sizes)))}")

    def network(parts: list[Tensor], mask: Tensor | None) -> Tensor | list[Tensor]:
        count, size = len(parts[0]), next(iter(sizes), len(parts[0]))
        results = run(parts) if size == count else batches(parts, count, size)
        return results if interface.memory else results[0]

    def batches(parts: list[Tensor], count: int, size: int) -> list[Tensor]:
        padding = -count % size
        padded = [torch.cat([part, part[:1].expand(padding, *part.shape[1:])]) for part in parts]
        pieces = [run(piece) for piece in zip(*(part.split(size) for part in padded), strict=True)]
        return [torch.cat(column)[:count] for column in zip(*pieces, strict=True)]

    return Loaded(lambda env, where: interface.policy(env, where, network), library)


# -- torch.export ----------------------------------------------------------------------------------------------------------------

INTERNAL = (
    "softmax|log_softmax|to_copy|unsafe_view|native_batch_norm_legit(_no_training)?|scaled_dot_product_flash_attention_for_cpu|"
    "local_scalar_dense|assert_(scalar|tensor_metadata)"
)
"""Operators of ATen with a leading underscore that programs may call; others, such as ``_unsafe_index_put``, check no bounds."""

TEXTS = {
    "target": re.compile(
        rf"torch\.ops\.aten\.(?!from_file\b)(_({INTERNAL})|(?!_)\w+)\.\w+|_operator\.(add|sub|mul|floordiv|neg|eq|ne|lt|le|gt|ge)"
    ),
    "expr_str": re.compile(r"(Symbol\('\w+'(, \w+=True)*\)|Mul\(|Integer\(|-?\d+|[ +(),-]|\*(?!\*))*"),
    "path_name": re.compile(r"(weight|tensor)_\d+"),
    "type": re.compile(r"builtins\.(tuple|list|dict)|cpu|cuda"),
    "context": re.compile(r'null|\[("\w*"(, "\w*")*)?\]'),
    "": re.compile(r"[\w.+:-]*"),
}
"""Texts in the program: the functions that it may call (``from_file`` writes files), sizes, which sympy evaluates as Python,
names of files, types of nested arguments; and all others, some of which torch writes into Python code."""

EMPTY: dict[str, object] = {"metadata": {}, "guards_code": []}
"""Entries that torch shows, or runs as checks, and the program does not need."""

REFUSED = ("as_graph", "as_operator", "as_custom_obj")
"""Kinds of arguments other than data."""

PARTS = re.compile(
    r"models/model\.json|data/(weights|constants)/(model_\w+_config\.json|(weight|tensor)_\d+)|data/sample_inputs/model\.pt"
    rf"|extra/{re.escape(CONTRACT)}|byteorder|archive_format|archive_version|\.data/\w+"
)
"""Entries of the archive of an exported program, below its folder."""


def exported_fault(path: Path) -> str:
    """Return what reading an exported program could execute; empty for one that calls operators of torch alone, or no archive."""
    if not zipfile.is_zipfile(path):
        return ""  # which is not read
    try:
        _screened(path.read_bytes())
    except ValueError as error:
        return f"torch.export.load could execute code in it: {error}"
    return ""


def _screened(content: bytes) -> bytes:
    """Return an archive with the same program, of entries that are data only.

    ``torch.export.load`` (2.13) unpickles, evaluates sizes and guards as Python, writes names into Python, calls any function of
    torch by its name, and loads compiled libraries. What could do so is a ValueError, or left out. The archive is written again,
    so that torch reads what was looked at.
    """
    clean = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive, zipfile.ZipFile(clean, "w") as copy:
            if sum(part.file_size for part in archive.infolist()) > len(content):
                raise ValueError("its archive unpacks to more than its own size")
            names = archive.namelist()
            if len(set(names)) < len(names) or len({name.partition("/")[0] for name in names}) != 1:
                raise ValueError("its archive has entries twice, or several folders")
            for name in names:
                short = name.partition("/")[2]
                if PARTS.fullmatch(short) is None:
                    raise ValueError(f"it has the entry {short!r:.80}")
                data = archive.read(name)
                if short.endswith(".json"):
                    data = json.dumps(_cleaned(parse_json(data, dict[str, object]))).encode()
                elif short.endswith(".pt"):
                    read_tensors(data)
                copy.writestr(name, data)
    except (zipfile.BadZipFile, RecursionError, NotImplementedError) as error:
        raise ValueError(str(error)) from error
    return clean.getvalue()


def _cleaned(value: object, key: str = "") -> object:
    """Return JSON of an exported program without :data:`EMPTY`; ValueError for what torch would unpickle, evaluate or call."""
    if key in EMPTY:
        return EMPTY[key]
    if key in REFUSED or (key == "use_pickle" and value):
        raise ValueError(f"it has {key}")
    if key in ("in_spec", "out_spec") and value:
        return json.dumps(_cleaned(parse_json(str(value).encode(), list[object])))
    if isinstance(value, dict):
        return {_cleaned(name): _cleaned(part, name) for name, part in value.items()}
    if isinstance(value, list):
        return [_cleaned(part, key) for part in value]
    if isinstance(value, str) and TEXTS.get(key, TEXTS[""]).fullmatch(value) is None:
        raise ValueError(f"it has {key or 'the text'} {value!r:.80}")
    return value


def read_exported(path: Path, trust: bool = False) -> Loaded:
    """Read a program of ``torch.export.save``; ValueError for a damaged one and, unless ``trust``, one with code."""
    extra = {CONTRACT: ""}
    try:
        content = path.read_bytes()
        if not trust:
            content = _screened(content)
        program = torch.export.load(io.BytesIO(content), extra_files=extra)
        module = program.module()
    except Exception as error:  # of many parts of torch
        raise ValueError(
            f"{str(path)!r} is no program of torch.export: {one_line(str(error)) or type(error).__name__}"
        ) from error
    title, inputs = f"the network of {str(path)!r}", program.graph_signature.user_inputs
    contract = contract_of(path, extra[CONTRACT] or None)
    shapes = {
        node.name: node.meta["val"].shape for node in program.graph.nodes if node.op == "placeholder" and "val" in node.meta
    }
    types = [node.meta["val"].dtype for node in program.graph.nodes if node.op == "placeholder" and node.name in inputs]
    lengths = [_length(shapes[name]) for name in inputs]
    outputs = _names_of(program.call_spec.out_spec, program.graph_signature.user_outputs)
    returned, names = _returned(title, _named(outputs, contract, "outputs")), _named(inputs, contract, "inputs")
    memory = _memory({name: shapes[key] for name, key in zip(names, inputs, strict=True)}, len(returned))
    interface = Interface(title, dict(zip(names, lengths, strict=True)), contract=contract, memory=memory)

    def run(parts: Sequence[Tensor]) -> list[Tensor]:
        tensors = [part.to("cpu", kind) for part, kind in zip(parts, types, strict=True)]
        positional, named = pytree.tree_unflatten(tensors, program.call_spec.in_spec)
        results = pytree.tree_leaves(module(*positional, **named))
        return [results[k] for k in returned]

    sizes = {shapes[name][0] for name in inputs if isinstance(shapes[name][0], int)}
    return _loaded(interface, run, sizes, f"torch {torch.__version__}")


def _named(names: Sequence[str], contract: Contract | None, part: Literal["inputs", "outputs"]) -> list[str]:
    """Return the names that a contract gives to as many inputs or outputs of a graph; else their own."""
    named = [quantity["name"] for quantity in (contract or {}).get(part, [])]
    return named if len(named) == len(names) else list(names)


def _names_of(spec: pytree.TreeSpec, names: Sequence[str]) -> list[str]:
    """Return the names of outputs: keys of a dictionary, else those in the graph."""
    keys = list(spec.context) if spec.type is dict else []
    return keys if len(keys) == len(names) else list(names)


# -- pickled modules -------------------------------------------------------------------------------------------------------------


def pickled_names(path: Path) -> list[str]:
    """Return the functions and classes that unpickling a file of ``torch.save`` calls, other than those of tensors."""
    try:
        with zipfile.ZipFile(path) as archive:
            name = next(name for name in archive.namelist() if name.endswith("data.pkl"))
            return [name for name in names_in(archive.read(name)) if not _is_plain(name)]
    except Exception:  # no archive of torch.save
        return []


def names_in(pickled: bytes) -> list[str]:
    """Return the functions and classes that a pickle names."""
    names, texts = [], [""]
    for opcode, argument, _ in pickletools.genops(pickled):
        if isinstance(argument, str) and opcode.name != "GLOBAL":
            texts.append(argument)
        elif opcode.name == "GLOBAL":
            names.append(str(argument).replace(" ", "."))
        elif opcode.name == "STACK_GLOBAL":
            names.append(".".join(texts[-2:]))
    return list(dict.fromkeys(names))


def _is_plain(name: str) -> bool:
    return name.startswith(("torch._utils._rebuild", "torch.serialization", "collections.OrderedDict")) or (
        name.startswith("torch.") and name.count(".") == 1
    )


def read_module(path: Path) -> Loaded:
    """Read a module of torch, saved whole; ValueError for anything else. Executes what the file names."""
    try:
        module = torch.load(path, map_location="cpu", weights_only=False)
    except Exception as error:  # unpickling may raise anything
        raise ValueError(f"{str(path)!r} cannot be unpickled: {type(error).__name__}: {error}") from error
    if not isinstance(module, nn.Module):
        raise ValueError(f"{str(path)!r} holds a {type(module).__name__}; save the module whole, torch.save(policy, file)")
    module.eval()
    return Loaded(lambda env, where: module.to(env.device), f"torch {torch.__version__}")
