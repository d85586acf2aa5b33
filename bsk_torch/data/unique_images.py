"""Knowledge of imaged targets."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor


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


class Known(NamedTuple):
    """The ``data_store`` of satellites; ``data`` is its content."""

    data: UniqueImages
