"""One door for policies: names, functions of the user's, and files of any library."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from tensordict.nn import TensorDictModuleBase
from torch import nn

from bsk_torch import __version__
from bsk_torch._listed import PLANNERS, PREFIX
from bsk_torch._rooms import resolve
from bsk_torch.env import Tasking
from bsk_torch.own_objects import import_object
from bsk_torch.rl.policies import network_files, rllib_checkpoint, sb3_zip
from bsk_torch.rl.policies.checksummed import is_checksummed
from bsk_torch.rl.policies.files import POLICY, build_policy, check_fits, read_card
from bsk_torch.rl.policies.interface import Loaded
from bsk_torch.rl.policies.shared_policy import RULES, fitting_baseline, shared
from bsk_torch.sim.names import nearest
from bsk_torch.wrappers.policies import Model

OBSERVED = ("observation", "obs")
"""Names of the first argument of functions that are policies themselves."""


class UntrustedError(ValueError):
    """Reading a file would execute code in it, and the caller has not allowed that."""


# -- files -----------------------------------------------------------------------------------------------------------------------


class Kind(NamedTuple):
    """A kind of files.

    Attributes:
        title: The kind in messages.
        is_kind: Whether a file or folder, which exists, is of this kind.
        executes: Returns what reading it executes; empty if nothing.
        read: Reads it; what it may execute then depends on whether the caller trusts the file.
    """

    title: str
    is_kind: Callable[[Path], bool]
    executes: Callable[[Path], str]
    read: Callable[[Path, bool], Loaded]


def _read_own(path: Path, trust: bool) -> Loaded:
    card = read_card(path)

    def fit(env: Tasking, where: str) -> TensorDictModuleBase:
        check_fits(card, env, where)
        return build_policy(card, env.device)

    return Loaded(fit, f"bsk_torch {card['bsk_torch']}", card)


def _checkpoint(path: Path) -> Path | None:
    """Return the last checkpoint of a folder of BenchMARL, or the one that is named; None if it is neither."""
    if path.is_file():
        return path if path.parent.name == "checkpoints" and (path.parent.parent / "config.pkl").is_file() else None
    files = (path / "checkpoints").glob("checkpoint_*.pt") if (path / "config.pkl").is_file() else ()
    return max(files, key=lambda file: (len(file.name), file.name), default=None)  # whose number is the largest


def _unpickles(path: Path) -> str:
    names = network_files.pickled_names(path)
    return f"torch unpickles it, which calls {', '.join(names[:5])}" + ", ..." * (len(names) > 5) if names else ""


OWN = "policy of bsk_torch"
"""Title of the kind that this package writes."""

KINDS = (
    Kind(OWN, lambda path: (path / POLICY).is_file() or is_checksummed(path), lambda path: "", _read_own),
    Kind("model of Stable-Baselines3", lambda path: path.suffix == ".zip", sb3_zip.pickled_parts, sb3_zip.read_sb3),
    Kind("ONNX file", lambda path: path.suffix == ".onnx", lambda path: "", lambda path, trust: network_files.read_onnx(path)),
    Kind(
        "program of torch.export", lambda path: path.suffix == ".pt2", network_files.exported_fault, network_files.read_exported
    ),
    Kind(
        "checkpoint of RLlib",
        rllib_checkpoint.is_checkpoint,
        lambda path: "RLlib unpickles it",
        lambda path, trust: rllib_checkpoint.read_checkpoint(path),
    ),
    Kind(
        "experiment of BenchMARL",
        lambda path: _checkpoint(path) is not None,
        lambda path: "BenchMARL's config.pkl and the checkpoint are unpickled",
        lambda path, trust: resolve("bsk_torch.rl.marl.benchmarl:read_experiment")(_checkpoint(path)),
    ),
    Kind("module of torch", lambda path: bool(_unpickles(path)), _unpickles, lambda path, trust: network_files.read_module(path)),
    Kind(OWN, lambda path: True, lambda path: "", _read_own),  # of release 0.1, or damaged
)
"""All kinds of files; the first that fits reads a file."""


def kind_of(path: Path) -> Kind:
    """Return the kind of a file or folder, which exists."""
    return next(kind for kind in KINDS if kind.is_kind(path))


def read_policy(source: Path | str, trust: bool = False) -> Loaded:
    """Read a policy from a file or folder of one of the :data:`KINDS`.

    Raises:
        FileNotFoundError: If there is none.
        ModuleNotFoundError: If a package is missing that reads the kind.
        UntrustedError: Unless ``trust``, for what would execute code.
        ValueError: For a damaged file; the message names it.
    """
    path = Path(source)
    if not path.exists():
        read_card(path)  # raises the error for what is missing
    kind = kind_of(path)
    if not trust and (code := kind.executes(path)):
        raise UntrustedError(
            f"{str(source)!r} is a {kind.title}: {code}, so that whoever made it decides what runs here; if you trust it, "
            "add --trust, or trust=True in Python"
        )
    return kind.read(path, trust)


# -- names -----------------------------------------------------------------------------------------------------------------------


def rule_named(name: str) -> Loaded:
    """Return one of the rules, to be fitted to an environment."""
    return Loaded(lambda env, where: fitting_baseline(name, env, where=where), f"bsk_torch {__version__}")


def is_function(name: str) -> bool:
    """Return whether a name is ``module:function`` or ``file.py:function``, and no file."""
    return ":" in name and not name.startswith(PREFIX) and not Path(name).exists()


def function_named(name: str) -> Any:
    """Return the policy or function ``module:name``, or ``file.py:name``, of the user's, whose code is executed.

    Raises:
        ValueError: If it cannot be imported, or is neither a policy nor callable.
    """
    named = import_object(name)
    if not callable(named) and not isinstance(named, Model):
        raise ValueError(f"{name} is neither a policy nor a function of a preset's name and make")
    return named


def is_policy(named: Any) -> bool:
    """Return whether an object is a policy itself: a torch module, a model, or a function of the observation."""
    if isinstance(named, nn.Module | Model):
        return True
    try:
        return next(iter(inspect.signature(named).parameters), None) in OBSERVED
    except ValueError:  # of a function that is not written in Python
        return False


def library_of(named: object) -> str:
    """Return the package of an object, with its version where it is known."""
    module = getattr(named, "__module__", None) or type(named).__module__
    package = module.partition(".")[0]
    for name in metadata.packages_distributions().get(package, [])[:1]:
        return f"{name} {metadata.version(name)}"
    return module


def load_policy(source: Path | str, env: Tasking, *, trust: bool = False) -> TensorDictModuleBase:
    """Return a policy of any library for all agents of an environment.

    ========================================  ===================================================================================
    source                                    executes
    ========================================  ===================================================================================
    run folder, policy file of this package   nothing
    name of a rule, such as ``"hasty"``       nothing; see :func:`~bsk_torch.rl.policies.shared_policy.rule`
    ``"plan:rollout,base=hasty"``             nothing: a planner with its options
    ``"module:name"``                         the module, which is yours: a policy, or a function of the observation
    ``"file.py:name"``                        the file, which is yours, too
    zip of Stable-Baselines3, sb3-contrib     nothing for networks of ``MlpPolicy`` and ``MultiInputPolicy``; others, and
                                              ``VecNormalize``, are unpickled, with ``trust``
    ONNX file                                 nothing
    program of ``torch.export``, ``.pt2``     nothing; with ``trust`` what torch reads beyond operators of ATen
    checkpoint of RLlib                       unpickled, with ``trust``
    experiment of BenchMARL, its checkpoint   unpickled, with ``trust``
    module saved by ``torch.save``            unpickled, with ``trust``
    ========================================  ===================================================================================

    Observations and actions are compared with those of the environment by name where the file has names, else by their number.

    Args:
        source: The policy.
        env: The environment in which it is to act.
        trust: Whether code in files may be executed.

    Raises:
        FileNotFoundError: If there is no such file.
        ModuleNotFoundError: If a package is missing that reads the file.
        UntrustedError: Unless ``trust``, for a file with code; the message names what would run.
        ValueError: For an unknown rule, a module that cannot be imported, a damaged file, or a policy with other observations or
            actions.
    """
    where, name = "this environment", str(source)
    if name in RULES:
        return shared(rule_named(name).fit(env, where), env)
    if name.startswith(PREFIX):
        return _planned(name, env, trust)
    if is_function(name):
        named = function_named(name)
        if not is_policy(named):
            raise ValueError(f"{name} is no policy but a function of a preset and make, for commands; call it in your program")
        return shared(named, env)
    path = Path(source)
    if path.name == name and not path.suffix and not path.exists():
        raise ValueError(f"{name!r} is neither a rule nor a file; {nearest(name, RULES)}")
    return shared(read_policy(source, trust).fit(env, where), env)


def _planned(name: str, env: Tasking, trust: bool) -> TensorDictModuleBase:
    """Return the planner ``plan:NAME,OPTION=VALUE,...``."""
    plain, *texts = name.removeprefix(PREFIX).split(",")
    if plain not in PLANNERS:
        raise ValueError(f"{name!r} is not a planner; {nearest(PREFIX + plain, [PREFIX + one for one in PLANNERS])}")
    options: dict[str, object] = resolve("bsk_torch.lab.planners.names:options_in")(plain, texts)
    base = {"base": load_policy(str(options["base"]), env, trust=trust)} if "base" in options else {}
    made: TensorDictModuleBase = resolve("bsk_torch.lab.planners.names:planner")(plain, env, **options | base)
    return made


def check_takes(function: Callable[..., object], title: str, texts: Sequence[str]) -> None:
    """Raise TypeError for a function that cannot be called with the name of a preset, ``make`` and further ``texts``."""
    try:
        signature = inspect.signature(function)
    except ValueError:  # of a function that is not written in Python
        return
    try:
        signature.bind("preset", "make", *texts)
    except TypeError as error:
        further = f", and the {len(texts)} texts after its commas" if texts else ""
        raise TypeError(
            f"{title} takes {signature}; it must take the name of a preset and make, (preset, make){further}: {error}"
        ) from error
