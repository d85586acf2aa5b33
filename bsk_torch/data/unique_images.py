"""Knowledge of imaged targets: tensors of all environments, and objects of one environment in bsk_rl's form."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from torch import Tensor

from bsk_torch.scene.target import Target


class UniqueImages(NamedTuple):
    """Image knowledge, shared by all satellites [N, ...] or per satellite of one type [N * count, ...].

    Attributes:
        imaged: Targets known to be imaged, [N, T] bool.
        known: Existing targets, [N, T] bool.
        duplicates: Number of images without a reward, [N] int64.
    """

    imaged: Tensor
    known: Tensor
    duplicates: Tensor


class UniqueImageData:
    """Images of targets of one environment, to be read.

    Attributes:
        imaged: Set of targets known to be imaged.
        duplicates: Number of repeated images.
        known: Set of targets known to exist.
    """

    def __init__(
        self, imaged: Iterable[Target] | None = None, duplicates: int = 0, known: Iterable[Target] | None = None
    ) -> None:
        """See the attributes; repetitions in ``imaged`` count as duplicates."""
        given = [] if imaged is None else list(imaged)
        self.imaged = set(given)
        self.duplicates = duplicates + len(given) - len(self.imaged)
        self.known = set(() if known is None else known)


class Known(NamedTuple):
    """A data store, like bsk_rl's ``satellite.data_store``: ``data`` is its content."""

    data: UniqueImages | UniqueImageData
