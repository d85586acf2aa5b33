"""Export a trained policy with its contract."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bsk_torch._listed import PREFIX
from bsk_torch.cli.names import PRETRAINED
from bsk_torch.files import write_file
from bsk_torch.lab.export.c_code import c_files
from bsk_torch.lab.export.contract import contract_of, page, places_of
from bsk_torch.lab.export.files import check_onnx, onnx_file, program_of, torch_file
from bsk_torch.lab.export.graph import PolicyGraph
from bsk_torch.lab.export.record import recorded
from bsk_torch.lab.export.shield import conditions
from bsk_torch.presets import make
from bsk_torch.rl.networks.plans import PLANS
from bsk_torch.rl.policies.files import build_policy, check_fits, networks_of, read_card
from bsk_torch.rl.policies.loading import OWN, kind_of
from bsk_torch.rl.policies.pretrained import pretrained_file
from bsk_torch.rl.policies.shared_policy import RULES, GroupPolicies, member_views
from bsk_torch.rl.rules.shield import find_rule
from bsk_torch.sim.names import nearest

FORMS = ("onnx", "torch", "c")
"""What a policy can be exported as."""

EPISODES = 4
"""Episodes flown for the record."""


def export_policy(
    policy: str | Path,
    folder: str | Path,
    forms: Sequence[str] = ("onnx",),
    *,
    preset: str | None = None,
    shield: str | None = None,
    **options: object,
) -> dict[str, dict[str, Any]]:
    """Write a trained policy as ``policy.onnx``, ``policy.pt2`` or ``policy.c``, with ``contract.json`` and ``contract.md``.

    Each file contains normalizer, network, mask, choice of the most probable action, and the shield if there is one. Some
    episodes are flown for a table of recorded decisions.

    Args:
        policy: A run folder, a policy file, or ``"pretrained"``.
        folder: Folder for the files, which is made if needed; several groups of satellites have a folder each in it.
        forms: Some of :data:`FORMS`.
        preset: Name of the environment; that of the training unless given, and needed for ``"pretrained"``.
        shield: Name of a shield to be included, ``"safe"`` or ``"imager"``.
        **options: Further arguments of the environment in which the record is flown, such as ``time_limit``.

    Returns:
        The contract of each group, by name.

    Raises:
        ValueError: For what is no policy of networks, an unknown form, a shield that cannot be exported, or an environment that
            the policy does not fit.
        ModuleNotFoundError: For ``"onnx"`` without the extra ``onnx``.
    """
    for form in forms:
        if form not in FORMS:
            raise ValueError(f"forms={list(forms)} has {form!r}; {nearest(form, FORMS)}")
    card = card_of(str(policy), preset)
    if "onnx" in forms:
        check_onnx()
    name = preset or card["preset"]
    env = make(name, num_envs=EPISODES, **(card["options"] | {"env_ids": [0] * EPISODES} | options))
    check_fits(card, env, name)
    built, parts, views = build_policy(card), networks_of(card), member_views(env)
    policies = dict(built.policies) if isinstance(built, GroupPolicies) else dict(zip(views, [built], strict=True))
    parts = dict(zip(views, parts.values(), strict=True)) if len(parts) == 1 else dict(parts)
    graphs = {group: PolicyGraph(PLANS[part["network"]](**part["plan"]), policies[group]) for group, part in parts.items()}
    records = recorded(env, policies, graphs)
    if shield is not None:
        rule = find_rule(shield)
        for group, graph in graphs.items():
            satellite = views[group].satellite
            places = places_of(graph, records[group], satellite)
            graph.only = conditions(rule, shield, places, satellite.action_description)
        records = recorded(env, policies, graphs)
    contracts, files = {}, {}
    for group, graph in graphs.items():
        record, satellite = records[group], views[group].satellite
        about = {"preset": name, "options": dict(card["options"]), "group": group, "shield": shield}
        contract = contract_of(graph, record, env, satellite, parts[group], about)
        made: dict[str, bytes | str] = {}
        if "onnx" in forms or "torch" in forms:
            program = program_of(graph, record)
            made |= {"policy.onnx": onnx_file(program, graph, contract)} if "onnx" in forms else {}
            made |= {"policy.pt2": torch_file(program, contract)} if "torch" in forms else {}
        if "c" in forms:
            title = f"policy for {name}, weights {contract['weights_sha256'][:16]}, by bsk_torch {contract['bsk_torch']}"
            made |= c_files(graph, record, title, graph.only)
        made["contract.json"] = json.dumps(contract, allow_nan=False) + "\n"
        made["contract.md"] = page(contract, [*made])
        contracts[group] = contract
        files[Path(folder) / ("" if len(graphs) == 1 else group)] = made
    for place, contents in files.items():
        place.mkdir(parents=True, exist_ok=True)
        for file, content in contents.items():
            write_file(place / file, content)
    return contracts


def card_of(policy: str, preset: str | None) -> dict[str, Any]:
    """Return the contents of a policy's file; ValueError, with what can be exported, unless this package wrote it."""
    kind = None
    if policy in RULES:
        kind = "a rule"
    elif policy.startswith(PREFIX):
        kind = "a planner, which simulates ahead"
    elif ":" in policy and not Path(policy).exists():
        kind = "a function of Python"
    elif Path(policy).exists() and (title := kind_of(Path(policy)).title) != OWN:
        kind = f"a policy of another library ({title})"
    if kind is not None:
        raise ValueError(
            f"{policy!r} is {kind}; bsk_torch exports its own networks: a run folder, a policy file, or {PRETRAINED!r}"
        )
    if policy == PRETRAINED and preset is None:
        raise ValueError(f"policy={PRETRAINED!r} needs preset, such as 'NadirScan-v1'")
    return read_card(pretrained_file(str(preset)) if policy == PRETRAINED else policy)
