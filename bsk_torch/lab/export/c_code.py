"""A policy as C99 without dependencies or allocation: one file of code and weights, a header, and a replay of the record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from bsk_torch.lab.export.graph import PolicyGraph
from bsk_torch.lab.export.record import Record
from bsk_torch.lab.export.shield import Only
from bsk_torch.rl.networks.attention import LEAST, SetActor
from bsk_torch.rl.networks.normaliser import LARGEST
from bsk_torch.rl.networks.plans import AttentionPlan

FOLDER = Path(__file__).parent

TOLERANCE = 1e-4
"""Largest difference of a logit, or of a real action as a share of its range, that counts as rounding. The sums of one logit in
float32, in another order, differ by up to 1e-5 in the networks of the package."""

HEADER = """/* {title}

   observation: {observed} numbers in the order of contract.json, finite
   mask:        {masked}
   out:         {out}
   Returns {returns}; -2 for an observation that is not finite.
   Needs math.h only. It allocates nothing{reentrant}. */
#ifndef BSK_POLICY_H
#define BSK_POLICY_H

#define BSK_POLICY_OBSERVED {observed}
#define BSK_POLICY_ACTIONS {actions}
#define BSK_POLICY_OUT {width}

int bsk_policy_act(const float *observation, const unsigned char *mask, float *out);

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
    header = HEADER.format(
        title=title,
        observed=observed,
        actions=actions,
        width=width,
        masked="not read" if graph.is_real else f"{actions} flags, 1 for a legal action",
        out=f"the {width} numbers of the action" if graph.is_real else f"the {width} logits before the mask",
        returns="0" if graph.is_real else "the number of the action, -1 if none is legal",
        reentrant=", but has static working memory: calls must not overlap" if graph.rows is not None else "",
    )
    sizes = {"LARGEST": f"{LARGEST}f"}
    if isinstance(graph.network, SetActor):
        parts = [constants(sizes | attention_sizes(graph, record)), attention_tables(graph), code("common.c", "attention.c")]
    else:
        parts = [constants(sizes), mlp_tables(graph), code("common.c"), mlp_code(graph)]
    parts += [real_act(graph)] if graph.is_real else [code("choose.c"), masked_act(only)]
    return {
        "policy.h": header,
        "policy.c": "\n".join([f"/* {title} */", '#include "policy.h"\n', *parts]),
        "recorded.h": recorded(graph, record),
        "replay.c": code("replay.c"),
    }


def code(*names: str) -> str:
    """Return files of this folder, one after the other."""
    return "".join((FOLDER / name).read_text() for name in names)


def constants(values: Mapping[str, object]) -> str:
    """Return macros."""
    return "".join(f"#define {name} {value}\n" for name, value in values.items())


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


def linear(name: str, layer: nn.Linear) -> list[tuple[str, Tensor]]:
    """Return weights [inputs, outputs] and biases of a layer."""
    return [(f"{name}_weight", layer.weight.mT), (f"{name}_bias", layer.bias)]


# -- networks of layers ----------------------------------------------------------------------------------------------------------


def mlp_layers(graph: PolicyGraph) -> list[nn.Linear]:
    """Return the linear layers; between them are hyperbolic tangents."""
    return [layer for layer in graph.network.modules() if isinstance(layer, nn.Linear)]


def mlp_tables(graph: PolicyGraph) -> str:
    """Return the weights."""
    arrays = [("own_mean", graph.own.mean), ("own_deviation", graph.own.deviation)]
    for k, layer in enumerate(mlp_layers(graph)):
        arrays += linear(f"layer_{k}", layer)
    return tables(arrays)


def mlp_code(graph: PolicyGraph) -> str:
    """Return the function ``network``."""
    layers = mlp_layers(graph)
    width = max(size for layer in layers for size in (layer.in_features, layer.out_features))
    calls = []
    for k, layer in enumerate(layers):
        last = k == len(layers) - 1
        source, target = f"x[{k % 2}]", "out" if last else f"x[{(k + 1) % 2}]"
        sizes = f"{layer.in_features}, {layer.out_features}"
        calls.append(f"    dense(layer_{k}_weight, layer_{k}_bias, {source}, {sizes}, {target});")
        if not last:
            calls.append(f"    squash({target}, {layer.out_features});")
    squash = (
        "\n/* the hyperbolic tangent, as 2 / (1 + exp(-2 x)) - 1 */\nstatic void squash(float *x, int n)\n{\n"
        "    for (int i = 0; i < n; ++i) {\n        x[i] = 2.0f / (1.0f + expf(-2.0f * x[i])) - 1.0f;\n    }\n}\n"
    )
    return (squash if len(layers) > 1 else "") + "\n".join(
        [
            "\n/* returns 0 for numbers that are not finite */",
            "static int network(const float *observation, float *out)",
            "{",
            f"    float x[2][{width}];",
            "    if (!standardize(observation, BSK_POLICY_OBSERVED, own_mean, own_deviation, x[0])) {",
            "        return 0;",
            "    }",
            *calls,
            "    return 1;",
            "}\n",
        ]
    )


# -- attention -------------------------------------------------------------------------------------------------------------------


def attention_sizes(graph: PolicyGraph, record: Record) -> dict[str, object]:
    """Return the sizes of the network and of its set, by their names in the code."""
    plan, network = graph.plan, graph.network
    assert isinstance(plan, AttentionPlan)
    assert isinstance(network, SetActor)
    encoder = network.encoder
    return {
        "OWN": plan.n_own,
        "FEATURES": plan.n_features,
        "ROWS": len(record.inputs[graph.paths[-2]][0]),
        "WIDTH": plan.hidden[0],
        "HEADS": encoder.blocks[0].heads,
        "BLOCKS": len(encoder.blocks),
        "FIRST": network.first,
        "OTHERS": network.n_others,
        "IMAGES": plan.n_actions - network.n_others,
        "EPSILON": literal(encoder.norm.eps),
        "LEAST": literal(LEAST),
    }


def attention_tables(graph: PolicyGraph) -> str:
    """Return the weights; those of a block are in the order in which the code counts them."""
    network = graph.network
    assert isinstance(network, SetActor)
    assert graph.rows is not None
    encoder, nothing = network.encoder, torch.zeros(0)
    arrays = [("own_mean", graph.own.mean), ("own_deviation", graph.own.deviation)]
    arrays += [("rows_mean", graph.rows.mean), ("rows_deviation", graph.rows.deviation)]
    for name in ("own", "context", "row", "mix"):
        arrays += linear(name, getattr(encoder, name))
    arrays += [("norm_weight", encoder.norm.weight), ("norm_bias", encoder.norm.bias), *linear("image", network.image)]
    arrays += [("other_weight", nothing), ("other_bias", nothing)] if network.other is None else linear("other", network.other)
    lists = []
    for k, block in enumerate(encoder.blocks):
        of_block: list[tuple[str, Tensor]] = []
        for name in ("norm", "queries_keys_values", "joined", "forward_norm", "wide", "narrow"):
            layer, title = getattr(block, name), f"block_{k}_{name}"
            weights = [(f"{title}_weight", layer.weight), (f"{title}_bias", layer.bias)]
            of_block += linear(title, layer) if isinstance(layer, nn.Linear) else weights
        arrays += of_block
        lists.append(f"{{{', '.join(name for name, _ in of_block)}}}")
    return tables(arrays) + f"static const float *const blocks[BLOCKS][12] = {{{', '.join(lists)}}};\n"


# -- the function, and the record ------------------------------------------------------------------------------------------------

ACT = """
int bsk_policy_act(const float *observation, const unsigned char *mask, float *out)
{{
    if (!network(observation, out)) {{
        return -2;
    }}
{body}}}
"""


def masked_act(only: Sequence[Only]) -> str:
    """Return the function that chooses an action; the first condition of a shield that holds leaves one action, if legal."""
    tests = []
    for one in only:
        signs = ("", "-") if one.absolute else ("",)
        words = [f"{sign}observation[{k}] {one.sign} {literal(one.threshold)}" for k in one.columns for sign in signs]
        tests.append(f"if ({' || '.join(words)}) {{\n        only = {one.action};\n    }}")
    if not tests:
        return ACT.format(body="    return choose(out, mask);\n")
    chain = " else ".join(tests)
    return ACT.format(body=f"    int only = -1;\n    {chain}\n    return only >= 0 && mask[only] ? only : choose(out, mask);\n")


def real_act(graph: PolicyGraph) -> str:
    """Return the function that computes real actions."""
    middle, reach = (table(name, values) for name, values in (("middle", graph.middle), ("reach", graph.reach)))
    edge = literal(float(torch.tensor(1.0 - 1e-6)))
    body = (
        "    (void)mask;\n    for (int j = 0; j < BSK_POLICY_OUT; ++j) {\n        const float y = tanhf(out[j]);\n"
        f"        out[j] = (y < -{edge} ? -{edge} : y > {edge} ? {edge} : y) * reach[j] + middle[j];\n    }}\n    return 0;\n"
    )
    return f"\n{middle}{reach}" + ACT.format(body=body)


def recorded(graph: PolicyGraph, record: Record) -> str:
    """Return the recorded decisions as arrays."""
    action, n = record.outputs["action"], len(record)
    expected = action if graph.is_real else record.outputs["logits"]
    scale = 2.0 * graph.reach if graph.is_real else torch.ones(expected.shape[-1])
    mask = torch.ones(n, 1) if graph.is_real else record.inputs[("action_mask",)]
    return "".join(
        [
            f"#define RECORDED {n}\n#define TOLERANCE {literal(TOLERANCE)}\n",
            table("observation", record.vectors()),
            table("mask", mask, "unsigned char"),
            table("action", torch.zeros(n) if graph.is_real else action, "int"),
            table("expected", expected),
            table("scale", scale),
        ]
    )
