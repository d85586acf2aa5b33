"""Targets spread uniformly over the Earth."""

from __future__ import annotations

from collections.abc import Iterable

from torch import Tensor
from typing_extensions import override

from bsk_torch.constants import R_EARTH
from bsk_torch.rand import Key, Uniform
from bsk_torch.scene.draws import (
    Count,
    Numbers,
    calls_user,
    check_numbers,
    check_radius,
    columns_for,
    count_range,
    draw_exists,
    draw_numbers,
    on_sphere,
)
from bsk_torch.scene.regenerated import draw_regenerated, made_again
from bsk_torch.scene.target import Target
from bsk_torch.scene.targets import TargetScenario
from bsk_torch.sim.hooks import check_class, overrides


class UniformTargets(TargetScenario):
    """Targets drawn uniformly by area from a sphere in every episode, as in bsk_rl's ``UniformTargets``.

    For other layouts, subclasses define :meth:`places`, or bsk_rl's :meth:`regenerate_targets`, which is slower.

    Attributes:
        targets: In :meth:`regenerate_targets`, the targets of one environment.
        n_targets: In :meth:`regenerate_targets`, the drawn number of targets.
    """

    _old_hooks = ("regenerate_targets",)
    targets: list[Target]
    n_targets: int
    regenerated_key: Key | None = None

    @override
    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        check_class(cls, UniformTargets, ("places", "regenerate_targets"), {})

    def __init__(self, n_targets: Count, priority_distribution: Numbers | None = None, radius: float = R_EARTH) -> None:
        """ValueError for a wrong argument.

        Args:
            n_targets: Number of targets, or a range (low, high) from which the number is drawn in each episode. ``high`` is
                exclusive, as in bsk_rl's code (its documentation describes it as inclusive). Without targets, satellites that
                look for targets raise RuntimeError as in bsk_rl, unless they are built with ``may_see_nothing=True``.
            priority_distribution: Priority of each target: a number, a distribution, or a callable without arguments
                called for each target; None for uniform in [0, 1).
            radius: Distance of the targets from the Earth's center, m.
        """
        self.low, self.end = count_range("n_targets", n_targets)
        self.most_targets = columns_for(self.end)
        self.priority_distribution = Uniform() if priority_distribution is None else priority_distribution
        check_numbers("priority_distribution", self.priority_distribution, self.most_targets)
        self.radius = check_radius("radius", radius)

    @property
    @override
    def calls_user(self) -> bool:
        return self._regenerates or calls_user(self.priority_distribution)

    @property
    def _regenerates(self) -> bool:
        """Whether a subclass defines bsk_rl's hook."""
        return overrides(self, UniformTargets, "regenerate_targets")

    def draw(self, key: Key) -> dict[str, Tensor]:
        """See :class:`TargetScenario`."""
        return draw_regenerated(self, key) if self._regenerates else self._draw_batch(key)

    def draw_exists(self, key: Key) -> Tensor:
        """Draw the number of targets; return 1.0 for the columns of targets, 0.0 for padding, [n or 1, T]."""
        return draw_exists(key.named("target_count"), self.low, self.end)

    def _draw_batch(self, key: Key) -> dict[str, Tensor]:
        exists = self.draw_exists(key)
        named = key.named("target_priority")
        priority = draw_numbers("priority_distribution", self.priority_distribution, named, self.most_targets)
        return {**self.places(key), "target_priority": priority * exists, "target_exists": exists}

    def places(self, key: Key) -> dict[str, Tensor]:
        """Draw positions: return ``target_r_LP_P`` [n or 1, T, 3] m, and optionally further values of the targets, by name."""
        u = key.named("target_r_LP_P").uniform(2 * self.most_targets)
        return {"target_r_LP_P": self.radius * on_sphere(u.view(len(key), -1, 2))}

    def regenerate_targets(self) -> None:
        """Set ``self.targets`` to the :class:`Target` objects of one environment; bsk_rl's hook.

        If a subclass defines this method, it is called at the reset of each environment, on a copy of the scenario with
        ``n_targets``, ``radius`` and ``priority_distribution``. NumPy's global generator then has a separate stream for each
        environment and episode. ``super().regenerate_targets()`` generates the targets of the base class. Numeric attributes of
        targets become drawn values; see :meth:`target_attribute`.
        """
        if self.regenerated_key is None:
            raise RuntimeError("regenerate_targets() is called by environments only, for each of them at its reset")
        values = self._draw_batch(self.regenerated_key)
        r_LP_P, priority = values["target_r_LP_P"][0].numpy(), values["target_priority"][0].tolist()
        names = self._names_of(values)
        self.targets = [Target(names[k], r_LP_P[k], priority[k]) for k in range(self.n_targets)]

    def _names_of(self, values: dict[str, Tensor]) -> list[str]:
        """Return the names of targets drawn for one environment."""
        return [f"tgt-{k}" for k in range(values["target_priority"].shape[1])]

    @override
    def names(self, row: int) -> list[str]:
        if not self._regenerates:
            return super().names(row)
        given = [target.name for target in self.target_objects(row)]
        return given + self.target_names[len(given) :]

    @override
    def _make_objects(self, row: int) -> Iterable[tuple[int, Target]]:
        return enumerate(made_again(self, row)) if self._regenerates else super()._make_objects(row)
