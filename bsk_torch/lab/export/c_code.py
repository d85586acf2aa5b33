"""A policy as C99 without dependencies or allocation: one file of code and weights, a header, and a replay of the record."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn

from bsk_torch.lab.export.graph import MASK, MEMORY, PolicyGraph, Recurrent, Standard
from bsk_torch.lab.export.record import Record
from bsk_torch.lab.export.shield import Only
from bsk_torch.rl.networks.attention import LEAST, SetActor
from bsk_torch.rl.networks.normaliser import LARGEST

FOLDER = Path(__file__).parent

TOLERANCE = 1e-4
"""Largest difference of a logit, or of a real action as a share of its range, that counts as rounding. The sums of one logit in
float32, in another order, differ by up to 1e-5 in the networks of the package."""

REMEMBERED = """
   memory:      {} numbers, 0 at the first decision of an episode; each call that does not return -2 replaces them"""

HEADER = """/* {title}

   observation: {observed} numbers in the order of contract.json, finite
   mask:        {masked}{remembered}
   out:         {out}
   Returns {returns}; -2 for {checked} not finite.
   Needs math.h only. It allocates nothing{reentrant}. */
#ifndef BSK_POLICY_H
#define BSK_POLICY_H

#define BSK_POLICY_OBSERVED {observed}
#define BSK_POLICY_ACTIONS {actions}
#define BSK_POLICY_OUT {width}
{macro}
int bsk_policy_act(const float *observation, const unsigned char *mask, {parameter}float *out);

#endif
"""


def c_files(graph: PolicyGraph, record: Record, title: str, only: Sequence[Only]) -> dict[str, str]:
    """Return the texts of ``policy.h``, ``policy.c``, ``recorded.h`` and ``replay.c``.

    Args:
        graph: The policy.
        record: Recorded decisions.
        title: What the policy is, for comments.
        only: The conditions of a shield, in order.
    """
    observed, actions = record.vectors().shape[-1], 0 if graph.is_real else graph.plan.n_actions
    width = record.outputs["action"].shape[-1] if graph.is_real else actions
    memory = record.inputs[MEMORY].shape[-1] if MEMORY in record.inputs else 0
    header = HEADER.format(
        title=title,
        observed=observed,
        actions=actions,
        width=width,
        masked="not read" if graph.is_real else f"{actions} flags, 1 for a legal action",
        out=f"the {width} numbers of the action" if graph.is_real else f"the {width} logits before the mask",
        returns="0" if graph.is_real else "the number of the action, -1 if none is legal",
        reentrant=", but has static working memory: calls must not overlap" if graph.rows is not None else "",
        remembered=REMEMBERED.format(memory) if memory else "",
        checked="an observation or memory that is" if memory else "an observation that is",
        macro=f"#define BSK_POLICY_MEMORY {memory}\n" if memory else "",
        parameter="float *memory, " if memory else "",
    )
    if isinstance(graph.network, SetActor):
        files, (sizes, weights) = ["attention.c"], attention(graph, graph.network, record)
    elif isinstance(graph.network, Recurrent):
        files, (sizes, weights) = ["squash.c", "gru.c"], recurrent(graph, graph.network)
    else:
        files, (sizes, weights) = ["squash.c", "mlp.c"], layered(graph, graph.network)
    macros = "".join(f"#define {name} {value}\n" for name, value in (sizes | {"LARGEST": literal(LARGEST)}).items())
    parts = [macros, weights, code("common.c", *files)]
    parts += [real_act(graph)] if graph.is_real else [code("choose.c"), masked_act(only, remembers=memory > 0)]
    return {
        "policy.h": header,
        "policy.c": "\n".join([f"/* {title} */", '#include "policy.h"\n', *parts]),
        "recorded.h": recorded(graph, record),
        "replay.c": code("replay.c"),
    }


def code(*names: str) -> str:
    """Return files of this folder, one after the other."""
    return "".join((FOLDER / name).read_text() for name in names)


def literal(value: float) -> str:
    """Return a float32 as a constant of C that is read as the same number."""
    text = f"{value:.9g}"
    return f"{text}f" if any(sign in text for sign in ".en") else f"{text}.0f"


def table(name: str, values: Tensor, kind: str = "float") -> str:
    """Return an array of one or two dimensions."""
    flat = values.detach().reshape(-1).tolist()
    words = [literal(value) if kind == "float" else str(int(value)) for value in flat] or ["0"]
    shape = "".join(f"[{max(size, 1)}]" for size in values.shape)
    row = values.shape[-1] if values.ndim == 2 else len(words)
    rows = [", ".join(words[k : k + row]) for k in range(0, len(words), row)]
    body = ",\n".join(f"{{{text}}}" for text in rows) if values.ndim == 2 else rows[0]
    return f"static const {kind} {name}{shape} = {{{body}}};\n"


def tables(arrays: Iterable[tuple[str, Tensor]]) -> str:
    """Return arrays of one dimension each, by name."""
    return "".join(table(name, values.reshape(-1)) for name, values in arrays)


def standards(name: str, standard: Standard) -> list[tuple[str, Tensor]]:
    """Return means and deviations."""
    return [(f"{name}_mean", standard.mean), (f"{name}_deviation", standard.deviation)]


def linear(name: str, layer: nn.Linear) -> list[tuple[str, Tensor]]:
    """Return weights [inputs, outputs] and biases of a layer."""
    return [(f"{name}_weight", layer.weight.mT), (f"{name}_bias", layer.bias)]


# -- networks of layers ----------------------------------------------------------------------------------------------------------


def layered(graph: PolicyGraph, network: nn.Module) -> tuple[dict[str, object], str]:
    """Return sizes by their names in the code, and the weights of the normalizer and of the layers of a network."""
    layers = [layer for layer in network.modules() if isinstance(layer, nn.Linear)]
    sizes = [layers[0].in_features, *(layer.out_features for layer in layers)]
    arrays = standards("own", graph.own)
    for k, layer in enumerate(layers):
        arrays += linear(f"layer_{k}", layer)
    pointers = ""
    for array, part in (("weights", "weight"), ("biases", "bias")):
        names = ", ".join(f"layer_{k}_{part}" for k in range(len(layers)))
        pointers += f"static const float *const {array}[LAYERS] = {{{names}}};\n"
    return {"WIDTH": max(sizes), "LAYERS": len(layers)}, tables(arrays) + pointers + table("sizes", torch.tensor(sizes), "int")


def recurrent(graph: PolicyGraph, network: Recurrent) -> tuple[dict[str, object], str]:
    """Return sizes by their names in the code, and the weights; those of the unit are in the order reset, update, new."""
    sizes, weights = layered(graph, network.layers)
    arrays = linear("head", network.head)
    for name, end in (("now", "ih_l0"), ("before", "hh_l0")):
        weight, bias = (getattr(network.unit, f"{part}_{end}") for part in ("weight", "bias"))
        arrays += [(f"{name}_weight", weight.mT), (f"{name}_bias", bias)]
    return sizes, weights + tables(arrays)


# -- attention -------------------------------------------------------------------------------------------------------------------


def attention(graph: PolicyGraph, network: SetActor, record: Record) -> tuple[dict[str, object], str]:
    """Return sizes by their names in the code, and the weights; those of a block are in the order in which the code counts."""
    encoder, n_own, n_features = network.encoder, len(graph.own.mean), len(cast(Standard, graph.rows).mean)
    n_rows = len(record.inputs[graph.paths[-2]][0])
    sizes: dict[str, object] = {"OWN": n_own, "FEATURES": n_features, "ROWS": n_rows, "WIDTH": encoder.mix.out_features}
    sizes |= {"HEADS": encoder.blocks[0].heads, "BLOCKS": len(encoder.blocks)}
    sizes |= {"FIRST": network.first, "OTHERS": network.n_others, "IMAGES": graph.plan.n_actions - network.n_others}
    arrays = standards("own", graph.own) + standards("rows", cast(Standard, graph.rows))
    for name in ("own", "context", "row", "mix"):
        arrays += linear(name, getattr(encoder, name))
    arrays += [("norm_weight", encoder.norm.weight), ("norm_bias", encoder.norm.bias), *linear("image", network.image)]
    nothing = [("other_weight", torch.zeros(0, dtype=torch.float32)), ("other_bias", torch.zeros(0, dtype=torch.float32))]
    arrays += nothing if network.other is None else linear("other", network.other)
    lists = []
    for k, block in enumerate(encoder.blocks):
        of_block: list[tuple[str, Tensor]] = []
        for name in ("norm", "queries_keys_values", "joined", "forward_norm", "wide", "narrow"):
            layer, title = getattr(block, name), f"block_{k}_{name}"
            weights = [(f"{title}_weight", layer.weight), (f"{title}_bias", layer.bias)]
            of_block += linear(title, layer) if isinstance(layer, nn.Linear) else weights
        arrays += of_block
        lists.append(f"{{{', '.join(name for name, _ in of_block)}}}")
    pointers = f"static const float *const blocks[BLOCKS][12] = {{{', '.join(lists)}}};\n"
    return sizes | {"EPSILON": literal(encoder.norm.eps), "LEAST": literal(LEAST)}, tables(arrays) + pointers


# -- the function, and the record ------------------------------------------------------------------------------------------------


def act(body: str, *, remembers: bool) -> str:
    """Return the function for one decision, of a network with a memory or without, which ends with ``body``."""
    declared, passed = ("float *memory, ", "memory, ") if remembers else ("", "")
    return f"""
int bsk_policy_act(const float *observation, const unsigned char *mask, {declared}float *out)
{{
    if (!network(observation, {passed}out)) {{
        return -2;
    }}
{body}}}
"""


def masked_act(only: Sequence[Only], *, remembers: bool) -> str:
    """Return the function that chooses an action; the first condition of a shield that holds leaves one action, if legal."""
    tests = []
    for one in only:
        signs = ("", "-") if one.absolute else ("",)
        words = [f"{sign}observation[{k}] {one.sign} {literal(one.threshold)}" for k in one.columns for sign in signs]
        tests.append(f"if ({' || '.join(words)}) {{\n        only = {one.action};\n    }}")
    if not tests:
        return act("    return choose(out, mask);\n", remembers=remembers)
    chain = " else ".join(tests)
    body = f"    int only = -1;\n    {chain}\n    return only >= 0 && mask[only] ? only : choose(out, mask);\n"
    return act(body, remembers=remembers)


def real_act(graph: PolicyGraph) -> str:
    """Return the function that computes real actions."""
    middle, reach = (table(name, values) for name, values in (("middle", graph.middle), ("reach", graph.reach)))
    edge = literal(float(torch.tensor(1.0 - 1e-6, dtype=torch.float32)))
    body = (
        "    (void)mask;\n    for (int j = 0; j < BSK_POLICY_OUT; ++j) {\n        const float y = tanhf(out[j]);\n"
        f"        out[j] = (y < -{edge} ? -{edge} : y > {edge} ? {edge} : y) * reach[j] + middle[j];\n    }}\n    return 0;\n"
    )
    return f"\n{middle}{reach}" + act(body, remembers=isinstance(graph.network, Recurrent))


def recorded(graph: PolicyGraph, record: Record) -> str:
    """Return the recorded decisions as arrays."""
    action, n = record.outputs["action"], len(record)
    expected = action if graph.is_real else record.outputs["logits"]
    scale = 2.0 * graph.reach if graph.is_real else torch.ones(expected.shape[-1], dtype=torch.float32)
    mask = torch.ones(n, 1, dtype=torch.float32) if graph.is_real else record.inputs[MASK]
    memories = []
    if MEMORY in record.inputs:
        memories = [("before", record.inputs[MEMORY].flatten(1)), ("after", record.outputs["next.memory"].flatten(1))]
    return "".join(
        [
            f"#define RECORDED {n}\n#define TOLERANCE {literal(TOLERANCE)}\n",
            table("observation", record.vectors()),
            table("mask", mask, "unsigned char"),
            table("action", torch.zeros(n, dtype=torch.float32) if graph.is_real else action, "int"),
            table("expected", expected),
            table("scale", scale),
            *(table(name, values) for name, values in memories),
        ]
    )
