"""Imitation of a rule before reinforcement learning.

The policy plays, the rule labels each situation with its action, and the policy learns these actions: data aggregation
(Ross et al. 2011, arXiv:1011.0686) in which the newest batch counts. Rules that rank actions by what these are worth can teach
probabilities instead, which tell how close a choice was (Hinton et al. 2015, arXiv:1503.02531). The critic learns the values of
what is played meanwhile, unless the whole training imitates.
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor

from bsk_torch.env import SatelliteTasking
from bsk_torch.env.action_forms import form
from bsk_torch.own_objects import import_object, name_of
from bsk_torch.rl.rules.baselines import BASELINES, RANKINGS
from bsk_torch.rl.rules.targets import Observation
from bsk_torch.rl.training.loss import log_probabilities, log_probability
from bsk_torch.sim.arguments.values import nearest
from bsk_torch.wrappers.policies import Actor, policy_of_one

TEACHERS = tuple(name for name in BASELINES if name != "random")
"""Rules of the package that can be imitated."""

OWN: dict[str, Actor] = {}
"""The user's rules entered in this process, by name."""

CHUNK = 2048
"""Situations that the rule judges at once: some compare all pairs of targets."""

RANKED = tuple(name for name in RANKINGS if name != "nearest")
"""Rules to which actions have a worth, so that they can teach probabilities; to ``nearest`` they only have an order."""

FAINT = 1e-60
"""Least scale of differences between worths, in double precision: worths in single precision are zero or larger than 1e-45."""

TAUGHT = "taught"
"""Key of the rule's actions, or of the probabilities that it is taken to give to all actions."""


def enter_teacher(rule: Actor | str) -> str:
    """Enter a rule of the user's among :data:`BASELINES` of this process, and return its name there.

    Args:
        rule: The name of a rule, which is returned unchanged unless it is ``module:name`` or ``file.py:name``, which are imported
            here; or a rule itself, see :func:`~bsk_torch.wrappers.policies.policy_of_one`.

    Raises:
        ValueError: For a name that cannot be imported.
        TypeError: For an object that is not a policy.
    """
    if isinstance(rule, str):
        if ":" not in rule or rule in OWN:
            return rule
        name, entered = rule, import_object(rule, "imitate")
    else:
        base = f"{getattr(rule, '__module__', 'own')}:{name_of(rule)}"
        names = (base, *(f"{base}_{k}" for k in range(2, len(OWN) + 3)))
        name, entered = next(name for name in names if OWN.get(name, rule) is rule), rule
    OWN[name] = entered

    def of(env: SatelliteTasking, seed: int = 0) -> TensorDictModuleBase:
        return policy_of_one(entered, env.satellite)

    BASELINES[name] = of
    return name


def check_teacher(name: str, temperature: float) -> None:
    """Raise ValueError unless there is such a rule, to which actions have a worth if ``temperature`` > 0.

    Names of the user's rules are not looked up: configurations are read from files, which name no code to execute.
    """
    if name not in TEACHERS and ":" not in str(name):
        raise ValueError(
            f"imitate={name!r} must be one of {list(TEACHERS)}, or a function, module:name or file.py:name; "
            f"{nearest(str(name), TEACHERS)}"
        )
    if temperature and name not in RANKED:
        raise ValueError(
            f"imitation_temperature={temperature:g} needs a rule to which actions have a worth, one of {list(RANKED)}; "
            f"imitation_temperature=0 imitates the actions of imitate={name!r}"
        )


def find_teacher(name: str, env: SatelliteTasking, temperature: float = 0.0) -> TensorDictModuleBase:
    """Return a module for an environment that writes a rule's actions [N], or probabilities of all actions [N, A].

    Args:
        name: The rule.
        env: The environment.
        temperature: Probabilities are proportional to exp(worth / (temperature * best)), with what actions are worth to the rule
            and the largest worth of an image in the same decision. Without an image of positive worth, the actions of the largest
            worth share the probability. 0 for actions.

    Raises:
        ValueError: If the rule does not fit the environment, or actions are real numbers.
    """
    if form(env.satellite) is not None:
        raise ValueError(
            f"imitate={name!r}: rules are imitated in choices only; the actions of {env.satellite.name} are real numbers"
        )
    if name not in BASELINES:
        raise ValueError(f"imitate={name!r} is a function of yours, which files cannot call: give imitate={name!r} again")
    try:
        rule = BASELINES[name](env, 0)
    except (KeyError, ValueError) as error:
        reason = f"{error.args[0]}; imitate=null trains without"
        raise ValueError(f"imitate={name!r} does not fit {env.satellite.name}: {reason}") from error
    if not temperature:
        return rule
    ranking = RANKINGS[name](env)

    def probabilities(observation: Observation, action_mask: Tensor) -> Tensor:
        worths = ranking.worths(observation, action_mask).double()
        best = worths[:, ranking.images.start : ranking.images.stop].amax(1, keepdim=True)  # a needed downlink takes all
        behind = worths - worths.amax(1, keepdim=True)
        return (behind / (temperature * best).clamp(FAINT, 1.0 / FAINT)).softmax(1, dtype=torch.float32)

    return TensorDictModule(probabilities, in_keys=["observation", "action_mask"], out_keys=["probabilities"])


@torch.no_grad()
def taught(teacher: TensorDictModuleBase, situations: TensorDictBase) -> Tensor:
    """Return what a teacher writes, [...] or [..., A], in ``situations`` [...] with ``observation`` and ``action_mask``.

    ValueError if it chooses an illegal action.
    """
    inputs = situations.select("observation", "action_mask").reshape(-1)
    lesson = torch.cat([teacher(part)[teacher.out_keys[0]] for part in inputs.split(CHUNK)])
    if not lesson.is_floating_point():
        legal = inputs["action_mask"]
        known = lesson.clamp(0, legal.shape[-1] - 1)
        wrong = legal.any(-1) & ~(legal.gather(-1, known.unsqueeze(-1)).squeeze(-1) & (known == lesson))
        if bool(wrong.any()):
            raise ValueError(f"imitate: the rule chooses the illegal action {int(lesson[wrong][0])}; let it obey the action mask")
    return lesson.view(*situations.batch_size, *lesson.shape[1:])


def imitation_loss(sample: TensorDictBase, counts: Tensor | None = None) -> Tensor:
    """Return the mean cross entropy of what was taught, over all decisions or those that ``counts`` marks.

    ``sample`` has the actor's logits [..., A], ``action_mask`` [..., A], and at :data:`TAUGHT` actions [...] or probabilities
    [..., A].
    """
    table, lesson = log_probabilities(sample["logits"], sample["action_mask"]), sample[TAUGHT]
    surprise = -(lesson * table).sum(-1) if lesson.is_floating_point() else -log_probability(table, lesson)
    return surprise.mean() if counts is None else surprise[counts].mean()
