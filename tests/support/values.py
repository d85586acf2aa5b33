"""Values as they are, where learners normalize them."""

import torch
from torch import Tensor
from torchrl.modules.value_norm import ValueNorm


class Unscaled(ValueNorm):
    """A mean of 0 and a deviation of 1, whatever comes."""

    def update(self, value_target: Tensor) -> None:
        """Take no notice."""

    def normalize(self, value_target: Tensor) -> Tensor:
        """Return the same."""
        return value_target

    def denormalize(self, normalised_value: Tensor) -> Tensor:
        """Return the same."""
        return normalised_value

    def scale(self) -> Tensor:
        """Return 1."""
        return torch.ones(1)
