"""Rules for teams of imagers of objects in orbit: each by what it knows, or all by one plan.

They are those of studies in BSK-RL's public branches, for :mod:`bsk_torch.tasks.objects.team_preset`. They look at the whole
environment, so they decide in the environment that they were made for, for its present state only.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from bsk_torch.astro.sight import line_clearance
from bsk_torch.env import ConstellationTasking
from bsk_torch.env.base import Tasking
from bsk_torch.rl.rules.baselines import TeamPolicy
from bsk_torch.rl.rules.observation_columns import Columns
from bsk_torch.sim.names import one_of
from bsk_torch.tasks.objects.act import ImageRSO
from bsk_torch.tasks.objects.aim import AIM
from bsk_torch.tasks.objects.outlook import LIT
from bsk_torch.tasks.objects.records import AGO
from bsk_torch.tasks.objects.rules import TEAMWORK
from bsk_torch.tasks.objects.scene import RSOTargets
from bsk_torch.vec3 import Vec3

TEAM_RULES = ("local", "centralized")

MOST_IMAGERS = 5
"""Imagers whose joint choices are enumerated, at most."""

KNOWN_RANK = 1e3
"""Rank of candidates that have been imaged, above all angles in degrees."""


class Choices(NamedTuple):
    """Candidates of A imagers, [N, A, K] each."""

    target: Tensor  # number of the target
    may: Tensor  # whether it can be imaged now: it exists, and is in sight and lit
    new: Tensor  # whether the imager knows no capture of it
    angle: Tensor  # angle from the instrument, degrees
    priority: Tensor  # priority


class TeamRule:
    """Decides for all imagers of a team that need a task.

    An imager charges, desaturates or downlinks when it needs to. Otherwise it images a candidate in sight and in light: first
    those without a known capture, then by the smallest angle, then by priority. The rule ``local`` does this for each imager. The
    rule ``centralized`` reserves the targets of running tasks, and of all joint choices takes the one with the most new targets,
    then the most images, the smallest sum of angles, and the highest priorities.
    """

    def __init__(self, env: Tasking, name: str = "local") -> None:
        """Make a rule for ``env``; ValueError for other satellites, or more than :data:`MOST_IMAGERS` if ``centralized``."""
        fits = isinstance(env, ConstellationTasking) and len(env.satellites) == 1 and not env.joint
        if not fits or not isinstance(env.scenario, RSOTargets) or env.scenario.knowledge != "own":
            raise ValueError("rules of teams need RSOTargets with knowledge='own', satellites of one type, and an agent for each")
        self.env, self.name = env, one_of("name", name, TEAM_RULES)
        self.satellite = env.satellites[0]
        self.scenario: RSOTargets = env.scenario
        self.images = self.satellite.action_description.index(f"{self._entry.name}_0")
        self.count = self.satellite.simulator.count
        if name == "centralized" and self.count > MOST_IMAGERS:
            raise ValueError(
                f"the rule 'centralized' enumerates joint choices of at most {MOST_IMAGERS} imagers; there are {self.count}"
            )

    @property
    def _entry(self) -> ImageRSO:
        """The action that images candidates, of which imagers have several; ValueError if there is none."""
        for entry in self.satellite.actions.entries:
            if isinstance(entry, ImageRSO) and entry.n_actions > 1:
                return entry
        raise ValueError(f"rules of teams need ImageRSO with several candidates; actions are {self.satellite.action_description}")

    def module(self) -> TeamPolicy:
        """Return the rule as a policy of the environment."""
        group = next(iter(self.env.group_map))
        return TeamPolicy(self, [(group, "observation"), (group, "action_mask")], [(group, "action")])

    def __call__(self, observation: Tensor, action_mask: Tensor) -> Tensor:
        """Return actions [N, A] for observations [N, A, F] and legal actions [N, A, n + 1]."""
        see = Columns(observation, self.satellite.observation_description)
        names = self.satellite.action_description
        stay = action_mask.shape[-1] - 1
        decides = action_mask[..., :stay].any(-1)
        wish = {name: mask & decides for name, mask in TEAMWORK.wishes(see).items()}
        busy = torch.stack(list(wish.values())).any(0)
        choices = self._choices(action_mask)
        images = decides & ~busy
        slot = self._joint(choices, images, decides) if self.name == "centralized" else self._local(choices)
        action = torch.where(slot < choices.may.shape[2], self.images + slot, names.index("action_charge"))
        for name, mask in wish.items():
            action = torch.where(mask, names.index(name), action)
        return torch.where(decides, action, stay)

    def _choices(self, action_mask: Tensor) -> Choices:
        satellite, scenario = self.satellite, self.scenario
        candidates = scenario.candidates(satellite, self._entry.n_actions)
        views = scenario.views(satellite, candidates)
        of_target = candidates.place.unsqueeze(-1).expand(-1, -1, 3)
        r_TN_N = satellite.of_env(scenario.r_TN_N).gather(1, of_target)
        r_BN_N = satellite.dynamics.r_BN_N.unsqueeze(1).expand_as(r_TN_N)
        sees = line_clearance(Vec3.of(r_BN_N), Vec3.of(r_TN_N)) > 0.0
        latest = scenario.of_imagers(satellite, scenario.known_records.latest()).gather(1, candidates.place)
        lit = views.target_illumination_factor >= LIT
        priority = satellite.of_env(scenario.priority).gather(1, candidates.place)
        columns = candidates.place, candidates.exists & sees & lit, latest == AGO, views.angle_to_target, priority
        return Choices(*(column.view(*action_mask.shape[:2], -1) for column in columns))

    def _local(self, choices: Choices) -> Tensor:
        """Return the candidate that each imager would choose, [N, A]; their number K where there is none."""
        rank = choices.angle + torch.where(choices.new, 0.0, KNOWN_RANK)
        rank = torch.where(choices.may, rank, torch.inf)
        return torch.where(choices.may.any(2), rank.argmin(2), rank.shape[2])

    def _joint(self, choices: Choices, images: Tensor, decides: Tensor) -> Tensor:
        """Return the candidates of the best joint choice, [N, A], for the imagers that ``images``; K for none."""
        number = choices.may.shape[2]
        reserved = self._reserved(decides)
        may = choices.may & images.unsqueeze(2)
        may = may & ~reserved.unsqueeze(1).expand(-1, self.count, -1).gather(2, choices.target)
        options = torch.tensor(list(itertools.product(range(number + 1), repeat=self.count)), device=may.device)

        def of_options(table: Tensor, none: float | bool) -> Tensor:
            """Return the entries [N, C, A] of a table [N, A, K] for all options [C, A]."""
            padded = torch.cat([table, torch.full_like(table[..., :1], none)], 2)
            return padded.gather(2, options.mT.unsqueeze(0).expand(len(table), -1, -1)).mT

        target, legal = of_options(choices.target, -1), of_options(may, True).all(2)
        for one, other in itertools.combinations(range(self.count), 2):
            legal &= (target[..., one] != target[..., other]) | (target[..., one] < 0)
        uses = options < number
        keys = (
            of_options(choices.new, False).sum(2).double(),
            uses.sum(1).double().expand(len(may), -1),
            -of_options(choices.angle, 0.0).sum(2),
            of_options(choices.priority, 0.0).sum(2),
        )
        return options[best(legal, keys)]

    def _reserved(self, decides: Tensor) -> Tensor:
        """Return the targets of the image tasks of imagers that do not decide, [N, G]."""
        simulator = self.satellite.simulator
        images = simulator.mode == simulator.mode_names.index("image_rso")
        runs = (images & ~self.satellite.task.requires_retasking & ~self.satellite.task.dead).view_as(decides) & ~decides
        target = simulator.memory[AIM].clamp(min=0).view_as(decides)
        counts = torch.zeros(len(decides), self.scenario.n_targets, dtype=torch.int64, device=decides.device)
        return counts.scatter_add(1, target, runs.long()) > 0


def best(legal: Tensor, keys: Iterable[Tensor]) -> Tensor:
    """Return the number of the first legal option [N, C] that is the largest by keys [N, C], the first of which counts most."""
    for key in keys:
        value = torch.where(legal, key, -torch.inf)
        legal = legal & (value >= value.amax(1, keepdim=True))
    return legal.byte().argmax(1)


def local(env: Tasking) -> TeamPolicy:
    """Return the rule by which each imager decides by what it knows; ValueError if it does not apply."""
    return TeamRule(env).module()


def centralized(env: Tasking) -> TeamPolicy:
    """Return the rule that takes the best joint choice; ValueError if it does not apply."""
    return TeamRule(env, "centralized").module()
