"""Your own environments in the place of presets: an environment, or a function that makes one."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cached_property
from typing import Any

import torch
from torchrl.envs import EnvBase

from bsk_torch.env import Tasking
from bsk_torch.own_objects import import_object, name_of
from bsk_torch.presets import PRESETS

Source = Tasking | Callable[..., Tasking]
"""An environment, or a function of ``num_envs`` that makes it."""

FORMS = "it must be an environment of bsk_torch, or a function of num_envs that returns one, such as 'def mine(num_envs): ...'"


class OwnEnvironment:
    """Makes environments of a :data:`Source` as presets do, with options of the environment."""

    def __init__(self, source: Source, title: str) -> None:
        """Use ``source``, called ``title`` in errors; TypeError for anything else."""
        if isinstance(source, EnvBase) and not isinstance(source, Tasking):
            raise TypeError(f"{title} is a {type(source).__name__}; {FORMS}; of a transformed one give base_env")
        if not isinstance(source, Tasking) and (isinstance(source, type) or not callable(source)):
            what = f"the class {source.__name__}" if isinstance(source, type) else f"{source!r:.80}"
            raise TypeError(f"{title} is {what}; {FORMS}")
        self.source, self.title = source, title
        self.takes: tuple[str, ...] | None = None if isinstance(source, Tasking) else self._names(source)

    def _names(self, function: Callable[..., Tasking]) -> tuple[str, ...] | None:
        """Return the arguments that a function takes by name; None for any."""
        parameters = inspect.signature(function).parameters.values()
        if any(p.kind is p.VAR_KEYWORD for p in parameters):
            return None
        names = tuple(p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY))
        if "num_envs" not in names:
            taken = f"({', '.join(p.name for p in parameters)})"
            raise TypeError(
                f"{self.title} takes {taken}; it must take num_envs, the number of episodes, as in 'def mine(num_envs): ...'"
            )
        return names

    @cached_property
    def sample(self) -> Tasking:
        """One such environment, to look at."""
        return self.source if isinstance(self.source, Tasking) else self(num_envs=1)

    def __call__(self, **options: Any) -> Any:
        """Return an environment; arguments that the function does not take replace arguments of what it returns."""
        if isinstance(self.source, Tasking):
            return self.source.remade(**options)
        rest = {} if self.takes is None else {name: value for name, value in options.items() if name not in self.takes}
        with torch.random.fork_rng(devices=[]):  # an environment without a seed draws one
            env = self.source(**{name: value for name, value in options.items() if name not in rest})
        if not isinstance(env, Tasking):
            raise TypeError(f"{self.title} returns {'nothing' if env is None else f'a {type(env).__name__}'}; {FORMS}")
        if env.num_envs != options.get("num_envs", env.num_envs):
            raise ValueError(f"{self.title} returns {env.num_envs} episodes for num_envs={options['num_envs']}; pass num_envs on")
        return env.remade(**rest) if rest else env


def enter(source: Source, name: str | None = None) -> str:
    """Enter your own environment among :data:`~bsk_torch.presets.PRESETS` of this process, and return its name there.

    Args:
        source: An environment, or a function of ``num_envs`` that makes one. Other options, such as ``time_limit``, are passed
            to a function that takes them or ``**options``, and otherwise replace arguments of the environment that it returns.
        name: Its name; by default after the function, ``module:function``, or the first satellite.

    Raises:
        TypeError: For anything else, or a function that does not take ``num_envs``.
    """
    if isinstance(source, Tasking):
        title = f"own:{source.names[0]}"
    else:
        title = f"{getattr(source, '__module__', 'own')}:{name_of(source)}"
    name = name or title
    PRESETS[name] = OwnEnvironment(
        source, "env" if isinstance(source, EnvBase) or not callable(source) else f"the function {title}"
    )
    return name


def enter_named(name: str) -> None:
    """Enter the function or environment that a user names, ``module:name`` or ``file.py:name``, under that name.

    ValueError or TypeError if there is none. Names in files must not come here: the module is executed.
    """
    enter(import_object(name, "preset"), name)
