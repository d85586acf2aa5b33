"""What is known of the images of targets: tensors of all environments, and the objects of one that bsk_rl's programs read."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from torch import Tensor

from bsk_torch.data.store import Data
from bsk_torch.scene.target import Target


class UniqueImages(NamedTuple):
    """Image knowledge, shared by all satellites [N, ...] or per satellite of one type [N * count, ...].

    Attributes:
        imaged: Targets that have been imaged, as far as is known, [N, T] bool.
        known: Targets that exist, [N, T] bool.
        duplicates: Images that paid nothing, [N] int64.
    """

    imaged: Tensor
    known: Tensor
    duplicates: Tensor


class UniqueImageData(Data):
    """Images of targets of one environment, in bsk_rl's form.

    Attributes:
        imaged: Set of targets that are known to have been imaged.
        duplicates: Number of repeated images; merging adds the targets that both have imaged, as in bsk_rl.
        known: Set of targets that are known to exist.
    """

    def __init__(
        self, imaged: Iterable[Target] | None = None, duplicates: int = 0, known: Iterable[Target] | None = None
    ) -> None:
        """See the attributes; repetitions in ``imaged`` count as duplicates."""
        given = [] if imaged is None else list(imaged)
        self.imaged = set(given)
        self.duplicates = duplicates + len(given) - len(self.imaged)
        self.known = set(() if known is None else known)

    def __add__(self, other: UniqueImageData) -> UniqueImageData:
        """Return both together."""
        imaged = self.imaged | other.imaged
        overlap = len(self.imaged) + len(other.imaged) - len(imaged)
        return type(self)(imaged=imaged, duplicates=self.duplicates + other.duplicates + overlap, known=self.known | other.known)


class Known(NamedTuple):
    """A store of data, as bsk_rl's ``satellite.data_store``: ``data`` is what it holds."""

    data: UniqueImages | UniqueImageData
