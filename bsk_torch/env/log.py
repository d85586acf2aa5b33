"""Log of satellite events in selected environments: decisions, images, deaths, rewards and ends of episodes.

The logger of a satellite is ``bsk_torch.sats.<name>``; the logger of the environments is ``bsk_torch.env``. Records have the
attributes ``env`` (row), ``episode``, ``sim_time`` (s since reset), ``satellite`` (None for an environment) and ``event``, one of
:data:`EVENTS`, and the attributes listed at the methods of :class:`StepLog`. If the level is disabled, nothing is read from the
simulation.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any, cast

from torch import Tensor

from bsk_torch._text import visible
from bsk_torch.env.satellite_group import SatelliteGroup
from bsk_torch.sats.bound import SatelliteFleet
from bsk_torch.sats.imaging import BoundImagingSatellite
from bsk_torch.scene.base import Scenario
from bsk_torch.scene.targets import TargetScenario

ROOT = "bsk_torch"

EVENTS = ("began", "chose", "took", "counted", "died", "idle", "legal", "step", "ended")
"""A new episode; a decision; an image; another counter that grew; a death; a satellite without task; its legal actions (of level
DEBUG); a step; the episode's end."""

Fields = dict[str, Any]


class SimulationFormatter(logging.Formatter):
    """Formats each record as one line: wall clock, logger, level, time since reset, environment and satellite, message."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        where = f"<{record.sim_time:.2f}> " if hasattr(record, "sim_time") else ""
        who = getattr(record, "satellite", None)
        where += f"env {record.env} " if getattr(record, "several", False) else ""  # type: ignore[attr-defined]
        title = record.name.removeprefix(f"{ROOT}.")
        line = (
            f"{self.formatTime(record)} {title:<24} {record.levelname:<8} {where}{f'{who}: ' if who else ''}{record.getMessage()}"
        )
        return visible(f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line)


def configure(level: int | str | None, file: str | Path | None) -> None:
    """Set up the package's logger.

    With a level, records are also shown on standard error, unless the program has its own handlers. With a file, records are
    appended to it. The level is WARNING if only a file is given.

    Args:
        level: Level of the logger ``bsk_torch``, such as ``"INFO"``; None leaves it unchanged.
        file: Path of the file (``log_dir`` of an environment), or None.
    """
    logger = logging.getLogger(ROOT)
    if level is not None or file is not None:
        logger.setLevel(read_level("WARNING" if level is None else level))
    if level is not None and not logger.hasHandlers():
        _add(logger, logging.StreamHandler())
    if file is None:
        return
    if not isinstance(file, str | os.PathLike):
        raise ValueError(f"log_dir={file!r} must be the path of a file, such as 'runs/log.txt', or None")
    path = Path(file).absolute()
    if path.is_dir():
        raise ValueError(f"log_dir={str(file)!r} is a folder; it must be the path of a file, such as 'runs/log.txt'")
    open_files = [handler.baseFilename for handler in logger.handlers if isinstance(handler, logging.FileHandler)]
    if str(path) not in open_files:
        path.parent.mkdir(parents=True, exist_ok=True)
        _add(logger, logging.FileHandler(path))


def read_level(level: int | str) -> int | str:
    """Return a level in the form used by :mod:`logging`; ValueError for an unknown one."""
    names = logging.getLevelNamesMapping() if hasattr(logging, "getLevelNamesMapping") else logging._nameToLevel
    wrong = level.upper() not in names if isinstance(level, str) else not isinstance(level, int) or isinstance(level, bool)
    if wrong:
        raise ValueError(f"log_level={level!r} must be one of {sorted(names)}, or a number")
    return level.upper() if isinstance(level, str) else level


def _add(logger: logging.Logger, handler: logging.Handler) -> None:
    handler.setFormatter(SimulationFormatter())
    logger.addHandler(handler)


class StepLog:
    """Records of the environments ``envs`` of a fleet. Call :meth:`decided`, :meth:`before` and :meth:`after` in every step."""

    def __init__(
        self, fleet: SatelliteFleet, satellites: Sequence[SatelliteGroup], scenario: Scenario, envs: Sequence[int]
    ) -> None:
        """Check the rows ``envs``; ValueError for an invalid one."""
        if isinstance(envs, str) or not isinstance(envs, Sequence):
            raise ValueError(f"log_envs={envs!r} must be a list of environments, such as [0]")
        for env in envs:
            if not isinstance(env, Integral) or isinstance(env, bool) or not 0 <= env < fleet.num_envs:
                raise ValueError(f"log_envs has {env!r}; it must hold rows from 0 to {fleet.num_envs - 1}")
        self.fleet, self.satellites, self.scenario, self.envs = fleet, satellites, scenario, list(envs)
        self.logger = logging.getLogger(f"{ROOT}.env")
        self.loggers = {name: logging.getLogger(f"{ROOT}.sats.{name}") for name in fleet.names}

    def shows(self, level: int = logging.INFO) -> bool:
        """Return whether records of a level are wanted."""
        return self.logger.isEnabledFor(level)

    def began(self, envs: Tensor, seeds: Tensor, episodes: Tensor) -> None:
        """Record new episodes in ``envs`` [n]: ``seed`` and ``episode``."""
        new = set(envs.tolist())
        for env in [env for env in self.envs if env in new]:
            seed, episode = int(seeds[env]), int(episodes[env])
            self._env(env, "began", "episode %d of seed %d begins", episode, seed, fields={"seed": seed})

    def decided(self, acts: Sequence[Tensor]) -> None:
        """Record decisions of the satellites ``acts`` [N * count] of each type: ``action``, ``target``, ``ends``.

        A continuous ``action`` is a list of its values.
        """
        if not self.shows():
            return
        for k, satellite in enumerate(self.satellites):
            ticks, h = satellite.task.ends, self.fleet.h
            for env, name, row in self._rows(k):
                if not bool(acts[k][row]):
                    continue
                chosen, ends = satellite.task.action[row], int(ticks[row]) * h
                title, action = satellite.actions.title(chosen), chosen.tolist()
                target = self._target(satellite, env, row) if self._images(satellite, action) else None
                fields = {"action": action, "action_name": title, "target": target, "ends": ends}
                text = "%s, until %.1f s at the latest" if target is None else "%s, until %.1f s at the latest: %s"
                self._satellite(name, env, "chose", text, title, ends, *([target] if target else []), fields=fields)

    def before(self) -> list[dict[str, Tensor]]:
        """Return the counters and deaths of each type before a run, for :meth:`after`."""
        return [{**satellite.counts(), "dead": satellite.task.dead} for satellite in self.satellites]

    def after(self, old: Sequence[Mapping[str, Tensor]], result: object, moves: Tensor) -> None:
        """Record the events of a step of the episodes ``moves`` [N].

        Attributes by event: ``took`` has ``target``; ``counted`` has ``counter`` and ``count``; ``died`` has ``checks``;
        ``legal`` has ``action_mask``; ``step`` has ``duration`` and ``reward``, summed over satellites; ``ended`` has
        ``terminated`` and ``truncated``.
        """
        flown = [env for env in self.envs if bool(moves[env])]
        for k, satellite in enumerate(self.satellites):
            counts, checks = satellite.counts(), None
            for env, name, row in self._rows(k):
                if env not in flown:
                    continue
                for counter, count in counts.items():
                    grown = int(count[row]) - int(old[k][counter][row])
                    if grown > 0:
                        self._counted(satellite, name, env, row, counter, grown)
                if bool(satellite.task.dead[row]) and not bool(old[k]["dead"][row]):
                    checks = satellite.aliveness() if checks is None else checks
                    failed = [check for check, alive in checks.items() if not bool(alive[row])]
                    text, fields = "died: %s failed", {"checks": failed}
                    self._satellite(name, env, "died", text, ", ".join(failed), fields=fields, level=logging.WARNING)
                elif bool(satellite.task.requires_retasking[row]):
                    self._satellite(name, env, "idle", "needs a task", fields={})
                if self.shows(logging.DEBUG):
                    self._legal(satellite, name, env, row)
        for env in flown if self.shows() else ():
            self._outcome(env, result)

    def _counted(self, satellite: SatelliteGroup, name: str, env: int, row: int, counter: str, grown: int) -> None:
        if counter in ("imaged", "missed"):
            target = self._target(satellite, env, row)
            event = "took" if counter == "imaged" else "counted"
            self._satellite(
                name, env, event, f"{counter} %s", target, fields={"target": target, "counter": counter, "count": grown}
            )
        else:
            self._satellite(name, env, "counted", "%s + %d", counter, grown, fields={"counter": counter, "count": grown})

    def _legal(self, satellite: SatelliteGroup, name: str, env: int, row: int) -> None:
        mask = satellite.action_mask()[row].tolist()
        if not mask:
            return  # real numbers, all of which are legal
        choices = satellite.action_description[-len(mask) :]
        legal = [action for action, may in zip(choices, mask, strict=True) if may]
        self._satellite(name, env, "legal", "may %s", ", ".join(legal), fields={"action_mask": mask}, level=logging.DEBUG)

    def _outcome(self, env: int, result: Any) -> None:
        duration, rewards = float(result.duration[env]), result.reward[env].tolist()
        paid = {name: reward for name, reward in zip(self.fleet.names, rewards, strict=True) if reward}
        fields = {"duration": duration, "reward": dict(zip(self.fleet.names, rewards, strict=True))}
        text = ", ".join(f"{name} {reward:.6g}" for name, reward in paid.items()) or "0"
        self._env(env, "step", "step of %.1f s, reward: %s", duration, text, fields=fields)
        ends = {"terminated": bool(result.terminated[env]), "truncated": bool(result.truncated[env])}
        if any(ends.values()):
            self._env(env, "ended", "episode %s", " and ".join(name for name, is_so in ends.items() if is_so), fields=ends)

    def _satellite(
        self, name: str, env: int, event: str, text: str, *args: object, fields: Fields, level: int = logging.INFO
    ) -> None:
        if self.shows(level):
            self.loggers[name].log(level, text, *args, extra=self._extra(env, event) | {"satellite": name} | fields)

    def _env(self, env: int, event: str, text: str, *args: object, fields: Fields) -> None:
        if self.shows():
            self.logger.info(text, *args, extra=self._extra(env, event) | {"satellite": None} | fields)

    def _extra(self, env: int, event: str) -> Fields:
        episode, time = int(self.fleet.state["episode"][env]), float(self.fleet.sim_time[env])
        return {"env": env, "episode": episode, "sim_time": time, "event": event, "several": len(self.envs) > 1}

    def _rows(self, k: int) -> list[tuple[int, str, int]]:
        names = self.satellites[k].names
        rows = [(env, name, env * len(names) + m) for env in self.envs for m, name in enumerate(names)]
        present = self.fleet.simulators[k].present
        return rows if present is None else [entry for entry in rows if bool(present[entry[2]])]

    @staticmethod
    def _images(satellite: SatelliteGroup, action: Any) -> bool:
        entry = satellite.actions.entries[satellite.actions.entry_of(action)]
        return hasattr(satellite, "latest_target") and getattr(entry, "n_negative_actions", 0) > 0

    def _target(self, satellite: SatelliteGroup, env: int, row: int) -> str | None:
        target = int(cast(BoundImagingSatellite, satellite).latest_target[row])
        return None if target < 0 else cast(TargetScenario, self.scenario).names(env)[target]
