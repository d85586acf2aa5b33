"""Exported files: ONNX, ``torch.export``, C."""

from __future__ import annotations

import io
import json
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import torch

from bsk_torch.lab.export.contract import KEY
from bsk_torch.lab.export.graph import PolicyGraph
from bsk_torch.lab.export.record import Record

if TYPE_CHECKING:
    from onnxscript import FLOAT
    from torch.export import ExportedProgram

OPSET = 18
"""Version of ONNX's operators in exported files, those of 2022."""


def check_onnx() -> None:
    """Raise ModuleNotFoundError, naming the extra, unless the packages that write ONNX are installed."""
    try:
        import onnx  # noqa: F401
        import onnxscript  # noqa: F401
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"ONNX files need {error.name}; pip install 'bsk_torch[onnx]'", name=error.name) from error


@contextmanager
def quiet() -> Iterator[None]:
    """Keep back what torch and onnxscript say about deprecations, passes and torchvision."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)


def program_of(graph: PolicyGraph, record: Record) -> ExportedProgram:
    """Return the graph as torch exports it, with any number of rows N."""
    inputs, rows = tuple(value[:2].contiguous() for value in record.inputs.values()), torch.export.Dim("N")
    with quiet(), torch.no_grad():
        return torch.export.export(graph.eval(), inputs, dynamic_shapes=(tuple({0: rows} for _ in inputs),))


def torch_file(program: ExportedProgram, contract: Mapping[str, object]) -> bytes:
    """Return a file of ``torch.export.save`` with the contract among its extra files."""
    buffer = io.BytesIO()
    with quiet():
        torch.export.save(program, buffer, extra_files={KEY: json.dumps(contract)})
    return buffer.getvalue()


def onnx_file(program: ExportedProgram, graph: PolicyGraph, contract: Mapping[str, object]) -> bytes:
    """Return an ONNX file of standard operators, with the contract in its metadata."""
    from onnxscript import opset18 as op

    def log1p(x: FLOAT) -> FLOAT:
        # ONNX has no log1p: log(u) x / (u - 1) with u = 1 + x is as exact (W. Kahan; Higham, Accuracy and Stability of
        # Numerical Algorithms, 1.14.1), where log(1 + x) loses small numbers
        one = op.Constant(value_float=1.0)
        u = op.Add(x, one)
        near = op.Equal(u, one)
        return op.Where(near, x, op.Div(op.Mul(op.Log(u), x), op.Sub(op.Where(near, op.Add(u, one), u), one)))

    with quiet(), torch.no_grad():
        program_onnx = torch.onnx.export(
            program,
            input_names=list(graph.names),
            output_names=list(graph.outputs),
            opset_version=OPSET,
            custom_translation_table={torch.ops.aten.log1p.default: log1p},
            verbose=False,
        )
    assert program_onnx is not None
    model = program_onnx.model_proto
    for value in (*model.graph.input, *model.graph.output, *model.graph.value_info):
        for dimension in value.type.tensor_type.shape.dim:
            if dimension.dim_param:
                dimension.dim_param = "N"
    entry = model.metadata_props.add()
    entry.key, entry.value = KEY, json.dumps(contract)
    return model.SerializeToString()
