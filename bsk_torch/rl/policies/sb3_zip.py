"""Models of Stable-Baselines3 and sb3-contrib, saved as zip files.

A zip file has the weights as tensors, and settings as JSON with pickled parts. The networks of ``MlpPolicy`` and
``MultiInputPolicy`` are built again from the weights and the texts next to the pickles, which needs no Stable-Baselines3 and
executes nothing. All others are loaded by the library, which unpickles.
"""

from __future__ import annotations

import io
import pickle
import re
import zipfile
from collections.abc import Mapping
from importlib import import_module
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from typing_extensions import override

from bsk_torch.env import Tasking
from bsk_torch.env.action_forms import form
from bsk_torch.rl.policies.interface import OBSERVATION, Interface, Loaded
from bsk_torch.rl.policies.shared_policy import member_view
from bsk_torch.untrusted import parse_json, read_tensors
from bsk_torch.wrappers.policies import ModelPolicy


class Actor(NamedTuple):
    """The network that acts in a policy: the prefix of its layers, the last layer if it is apart, and the usual activation."""

    layers: str
    last: str
    activation: str


ACTORS = {
    "stable_baselines3.common.policies": Actor("mlp_extractor.policy_net.", "action_net.", "Tanh"),
    "sb3_contrib.common.maskable.policies": Actor("mlp_extractor.policy_net.", "action_net.", "Tanh"),
    "stable_baselines3.dqn.policies": Actor("q_net.q_net.", "", "ReLU"),
    "stable_baselines3.sac.policies": Actor("actor.latent_pi.", "actor.mu.", "ReLU"),
}
"""Networks by the module of the policy's class."""

MASKED, SQUASHED = "sb3_contrib.common.maskable.policies", "stable_baselines3.sac.policies"
"""Modules whose policies take masks, and whose actions are the hyperbolic tangent of the network."""

ALGORITHMS = {
    "stable_baselines3.common.policies": "stable_baselines3:PPO",
    "stable_baselines3.dqn.policies": "stable_baselines3:DQN",
    "stable_baselines3.sac.policies": "stable_baselines3:SAC",
    "stable_baselines3.td3.policies": "stable_baselines3:TD3",
    "sb3_contrib.common.maskable.policies": "sb3_contrib:MaskablePPO",
    "sb3_contrib.qrdqn.policies": "sb3_contrib:QRDQN",
    "sb3_contrib.tqc.policies": "sb3_contrib:TQC",
    "sb3_contrib.crossq.policies": "sb3_contrib:CrossQ",
}
"""Classes that load a model, by the module of the policy's class; PPO loads models of A2C, whose policies are the same."""

OTHERS = ("mlp_extractor.value_net.", "value_net.", "log_std", "q_net_target.", "critic", "actor.log_std.")
"""Prefixes of weights that do not act."""

SETTINGS = (
    *("net_arch", "activation_fn", "optimizer_class", "optimizer_kwargs", "use_sde", "log_std_init", "ortho_init", "n_critics"),
    *("normalize_images", "share_features_extractor"),
)
"""Arguments of policies with which the network is known from its weights."""

ACTIVATIONS = ("Tanh", "ReLU", "ELU", "SiLU", "Sigmoid", "Softplus", "Softsign", "Mish", "LeakyReLU", "GELU")
"""Classes of torch with usual arguments."""

NORMALIZERS = ("vecnormalize.pkl", "vec_normalize.pkl", "normalize.pkl")
"""Files of ``VecNormalize`` next to a model, which its zip file does not mention."""

SPACE = re.compile(r"'([^']+)': Box\([^()]*\(([\d, ]*)\), float32\)")
"""A part of a named observation, with its shape."""


class Archive(NamedTuple):
    """Contents of a zip file: settings, weights, and the version of the library."""

    data: dict[str, Any]
    weights: dict[str, Tensor]
    version: str

    @property
    def module(self) -> str:
        """Module of the policy's class."""
        kind = self.data.get("policy_class")
        return str(kind.get("__module__")) if isinstance(kind, dict) else ""


def _archive(path: Path) -> Archive:
    """Read a zip file without its pickles; ValueError for a damaged one."""
    try:
        content = path.read_bytes()
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(part.file_size for part in archive.infolist()) > len(content):
                raise ValueError("its archive unpacks to more than its own size")
            data = parse_json(archive.read("data"), dict[str, Any])
            weights, _ = read_tensors(archive.read("policy.pth"))
            version = (
                archive.read("_stable_baselines3_version").decode() if "_stable_baselines3_version" in archive.namelist() else ""
            )
        if (
            not isinstance(data, dict)
            or not isinstance(weights, dict)
            or not all(isinstance(w, Tensor) for w in weights.values())
        ):
            raise ValueError("its weights are no dictionary of tensors")
    except (ValueError, KeyError, RecursionError, NotImplementedError, zipfile.BadZipFile) as error:
        reason = error.args[0] if error.args else type(error).__name__
        raise ValueError(f"{str(path)!r} is no model of Stable-Baselines3: {reason}") from error
    return Archive(data, weights, version if version.isprintable() else "")


def pickled_parts(path: Path) -> str:
    """Return what must be unpickled to use a model, and why; empty if its network is known without."""
    if normalizer := _normalizer(path):
        return f"{str(normalizer)!r} next to it is a pickle, with which its observations are normalized"
    fault = _fault(_archive(path))
    return f"Stable-Baselines3 unpickles its settings ({fault})" if fault else ""


def _normalizer(path: Path) -> Path | None:
    """Return the statistics of ``VecNormalize`` next to a model, also those of a checkpoint of the same step."""
    step = re.sub(r"_(\d+_steps)$", r"_vecnormalize_\1", path.stem)
    names = (*NORMALIZERS, *([f"{step}.pkl"] if step != path.stem else []))
    return next((path.with_name(name) for name in names if path.with_name(name).is_file()), None)


def _fault(archive: Archive) -> str:
    """Return why a network cannot be built from its weights; empty if it can."""
    kind, data = ACTORS.get(archive.module), archive.data
    settings = data.get("policy_kwargs")
    if kind is None:
        return f"its policy is of {archive.module:.80}"
    if not isinstance(settings, dict) or data.get("use_sde"):
        return "it explores by states"
    if unknown := [name for name in settings if not name.startswith(":") and name not in SETTINGS]:
        return f"its policy has the argument {unknown[0]:.80}"
    if _activation(archive) not in ACTIVATIONS:
        return f"its activation is {_activation(archive):.80}"
    known = (kind.layers, kind.last or kind.layers, *OTHERS)
    if unknown := [name for name in archive.weights if not str(name).startswith(known)]:
        return f"its network has {unknown[0]:.80}"
    if _space(data, "action_space") not in ("Discrete", "Box") or _space(data, OBSERVATION + "_space") not in ("Box", "Dict"):
        return "its spaces are of other kinds"
    try:
        _network(archive)
        _inputs(archive)
    except (KeyError, RuntimeError, TypeError, ValueError) as error:
        return f"its network is unusual: {error}"
    return ""


def _space(data: Mapping[str, object], name: str) -> str:
    space = data.get(name)
    return str(space.get(":type:", "")).rpartition(".")[2].removesuffix("'>") if isinstance(space, dict) else ""


def _activation(archive: Archive) -> str:
    chosen = archive.data["policy_kwargs"].get("activation_fn")
    return ACTORS[archive.module].activation if chosen is None else str(chosen).rpartition(".")[2].removesuffix("'>")


def _network(archive: Archive) -> nn.Sequential:
    """Return the network that acts, from its weights; KeyError, RuntimeError or ValueError for other weights."""
    kind, weights = ACTORS[archive.module], archive.weights
    numbers = sorted({int(name.removeprefix(kind.layers).partition(".")[0]) for name in weights if name.startswith(kind.layers)})
    names = [f"{kind.layers}{number}." for number in numbers] + ([kind.last] if kind.last else [])
    layers: list[nn.Module] = []
    for name in names:
        weight, bias = weights[f"{name}weight"].float(), weights[f"{name}bias"].float()
        layer = nn.Linear(weight.shape[1], weight.shape[0])
        layer.load_state_dict({"weight": weight, "bias": bias})
        layers += [layer, getattr(nn, _activation(archive))()]
    if not all(bool(part.isfinite().all()) for layer in layers for part in layer.parameters()):
        raise ValueError("it has weights that are not finite")
    return nn.Sequential(*layers[:-1]).requires_grad_(False)


def _inputs(archive: Archive) -> dict[str, int | None]:
    """Return the lengths of the observations by name, in the order in which the network has them."""
    first, space = _network(archive)[0], archive.data[OBSERVATION + "_space"]
    assert isinstance(first, nn.Linear)
    if _space(archive.data, OBSERVATION + "_space") == "Box":
        return {OBSERVATION: first.in_features}
    parts = {name: prod(int(n) for n in shape.split(",") if n.strip()) for name, shape in SPACE.findall(str(space.get("spaces")))}
    if sum(parts.values()) != first.in_features:
        raise ValueError("its observations are not the inputs of its network")
    return dict(parts)


def read_sb3(path: Path, trust: bool = False) -> Loaded:
    """Read a model; ValueError for a damaged one and, unless ``trust``, one that must be unpickled."""
    archive, normalizer = _archive(path), _normalizer(path)
    library = f"stable-baselines3 {archive.version}".strip()
    if normalizer is None and not _fault(archive):
        network, is_real = _network(archive), _space(archive.data, "action_space") == "Box"
        last = network[-1]
        assert isinstance(last, nn.Linear)
        interface = Interface(f"the model {str(path)!r}", _inputs(archive), last.out_features, is_real)
        return Loaded(lambda env, where: _built(archive.module, network, interface, env, where), library)
    if not trust:  # the file has changed since it was looked at
        raise ValueError(f"{str(path)!r} must be unpickled")
    if archive.module not in ALGORITHMS:
        raise ValueError(f"{str(path)!r} has a policy of {archive.module:.80}; name a function that loads it, module:function")
    package, _, name = ALGORITHMS[archive.module].partition(":")
    try:
        kind = getattr(import_module(package), name)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"a model of {name} needs {package}: pip install 'bsk_torch[sb3]'") from error
    try:
        model = kind.load(path, device="cpu")
        statistics = None if normalizer is None else pickle.loads(normalizer.read_bytes())
    except Exception as error:  # unpickling may raise anything
        raise ValueError(f"{str(path)!r} cannot be loaded by Stable-Baselines3: {type(error).__name__}: {error}") from error
    return Loaded(lambda env, where: _predicted(path, model, statistics, env, where), library)


def _built(module: str, network: nn.Sequential, interface: Interface, env: Tasking, where: str) -> TensorDictModuleBase:
    """Return the policy of a network for an environment."""
    network = network.to(env.device)
    builder = form(member_view(env).satellite)

    def act(parts: list[Tensor], mask: Tensor | None) -> Tensor:
        result = network(torch.cat([part.reshape(len(part), -1).float() for part in parts], -1))
        if builder is None:
            chosen = result.argmax(-1)
            return result if module == MASKED or bool(result.isnan().any()) else chosen
        low, high = builder.low.to(result), builder.high.to(result)
        return low + 0.5 * (result.tanh() + 1.0) * (high - low) if module == SQUASHED else result.maximum(low).minimum(high)

    return interface.policy(env, where, act)


class NormalizedModel(ModelPolicy):
    """A model with the statistics of ``VecNormalize``."""

    statistics: Any = None

    @override
    def _inputs(self, observation: object) -> object:
        inputs = super()._inputs(observation)
        return inputs if self.statistics is None else self.statistics.normalize_obs(inputs)


def _predicted(path: Path, model: Any, statistics: Any, env: Tasking, where: str) -> TensorDictModuleBase:
    """Return the policy of a model of the library; ValueError if its spaces are others than those of ``env``."""
    space, action = model.observation_space, model.action_space
    lengths = (
        {name: prod(box.shape) for name, box in space.spaces.items()}
        if hasattr(space, "spaces")
        else {OBSERVATION: prod(space.shape)}
    )
    count = int(action.n) if hasattr(action, "n") else prod(action.shape)
    interface = Interface(f"the model {str(path)!r}", lengths, count, not hasattr(action, "n"))
    interface.check(member_view(env), where)
    policy = NormalizedModel(model, member_view(env).satellite)
    policy.statistics, policy.title = statistics, interface.title
    interface.try_policy(policy, env, where)
    return policy
