"""Small policies of each kind, untrained but with statistics of flown observations, and their C code."""

import ctypes
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

import bsk_torch
from bsk_torch.lab.export import export_policy
from bsk_torch.rl.networks.plans import PLANS
from bsk_torch.rl.policies.files import build_policy, networks_of, read_card, save_policy
from bsk_torch.rl.policies.shared_policy import GroupPolicies, member_views

KINDS = {
    "mlp": ("NadirScan-v1", {"time_limit": 4000.0}, {"agents": ("mlp", (8, 8))}),
    "gru": ("NadirScan-v1", {"time_limit": 4000.0}, {"agents": ("gru", (10, 6))}),
    "real": ("CWDocking-v1", {}, {"agents": ("mlp", (8,))}),
    "real gru": ("CWDocking-v1", {}, {"agents": ("gru", (8, 6))}),
    "attention": ("AEOSPower-v1", {"as_set": True, "n_targets": 300, "time_limit": 1200.0}, {"agents": ("attention", (32, 32))}),
    "groups": (
        "RelayConstellation-v1",
        {"as_set": True, "n_targets": 300, "time_limit": 600.0},
        {"broadcasting_set_imager": ("attention", (32,)), "relay": ("mlp", (8,))},
    ),
}
"""Preset, options, and networks of each group."""


@dataclass
class Exported:
    """A policy's file, its options, its contract by group, and the folder of each group's files."""

    file: Path
    preset: str
    options: dict
    contracts: dict
    folders: dict

    def policies(self):
        """The package's policy of each group."""
        built = build_policy(read_card(self.file))
        return dict(built.policies) if isinstance(built, GroupPolicies) else dict(zip(self.folders, [built], strict=True))

    def graphs(self):
        """The graph of each group, without a shield."""
        from bsk_torch.lab.export.graph import PolicyGraph

        parts = networks_of(read_card(self.file))
        plans = {group: PLANS[part["network"]](**part["plan"]) for group, part in parts.items()}
        return {group: PolicyGraph(plans[group], policy) for group, policy in self.policies().items()}


def save(kind, file):
    """Write an untrained policy whose logits are a few units apart."""
    preset, options, networks = KINDS[kind]
    views = member_views(bsk_torch.make(preset, num_envs=1, **options))
    plans = {group: PLANS[network].of(views[group], hidden) for group, (network, hidden) in networks.items()}
    torch.manual_seed(0)
    built = {group: plan.build() for group, plan in plans.items()}
    for each in built.values():
        for state in (each.normaliser.own, getattr(each.normaliser, "rows", None)):
            if state is not None:
                state.mean.copy_(torch.linspace(-0.2, 0.3, len(state.mean)))
                state.variance.copy_(torch.linspace(0.05, 0.4, len(state.mean)))
        for layer in each.actor.modules():
            if isinstance(layer, torch.nn.Linear):
                torch.nn.init.normal_(layer.weight, std=1.5 * layer.in_features**-0.5)
                torch.nn.init.normal_(layer.bias, std=0.3)
            elif isinstance(layer, torch.nn.GRU):
                torch.manual_seed(5)  # actions differ, and most depend on the memory
                for weight in layer.parameters():
                    torch.nn.init.normal_(weight, std=1.5)
    one = len(plans) == 1
    save_policy(file, *(next(iter(part.values())) if one else part for part in (plans, built)), preset, options)
    return file, preset, options


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """Exports a kind of policy as C, once."""
    made = {}

    def export(kind):
        if kind not in made:
            folder = tmp_path_factory.mktemp(kind)
            file, preset, options = save(kind, folder / "policy.pt")
            contracts = export_policy(file, folder / "out", ["c"])
            folders = {group: folder / "out" / ("" if len(contracts) == 1 else group) for group in contracts}
            made[kind] = Exported(file, preset, options, contracts, folders)
        return made[kind]

    return export


def compiled(folder):
    """The C function of a folder, and what the replay of the record prints."""
    flags = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-O1"]
    subprocess.run([*flags, "-shared", "-fPIC", folder / "policy.c", "-o", folder / "policy.so", "-lm"], check=True)
    subprocess.run([*flags, folder / "policy.c", folder / "replay.c", "-o", folder / "replay", "-lm"], check=True)
    replay = subprocess.run([folder / "replay"], check=True, capture_output=True, text=True).stdout
    function = ctypes.CDLL(str(folder / "policy.so")).bsk_policy_act

    def act(vectors, masks, width, *memory):
        """Numbers returned [n], and outputs [n, width], of vectors [n, D] and masks [n, A]; changes a memory [n, 1, H]."""
        vectors, masks = vectors.float().contiguous().numpy(), masks.to(torch.uint8).contiguous().numpy()
        out, chosen = np.zeros((len(vectors), width), np.float32), []
        for row in zip(vectors, masks, *(part.numpy() for part in memory), out, strict=True):
            chosen.append(function(*(ctypes.c_void_p(part.ctypes.data) for part in row)))
        return torch.tensor(chosen), torch.from_numpy(out)

    return act, replay


def situations(graph, contract, n=200):
    """Random inputs of a graph, with padding, and masks of which some leave one action."""
    generator = torch.Generator().manual_seed(1)
    inputs = []
    for row in contract["inputs"]:
        shape = (n, *row["shape"][1:])
        if row["type"] == "bool":
            mask = torch.rand(shape, generator=generator) < torch.rand((n, 1), generator=generator)
            inputs.append(mask.index_fill(0, torch.arange(0, n, 7), False))
            first = torch.randint(shape[1], (n,), generator=generator)
            inputs[-1][torch.arange(n), first] = True
        elif row["name"] == "memory":
            inputs.append(torch.rand(shape, generator=generator) * 2.0 - 1.0)
        elif row["name"].endswith(".mask"):
            inputs.append((torch.rand(shape, generator=generator) < 0.7).float())
        else:
            inputs.append(torch.randn(shape, generator=generator) * 10.0 ** torch.randint(-3, 4, shape, generator=generator))
    return inputs
