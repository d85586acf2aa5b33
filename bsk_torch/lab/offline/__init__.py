"""Offline data: episodes of several behaviors, with the returns of all actions at a sample of decisions.

:func:`~bsk_torch.lab.offline.write_dataset` plays the episodes and writes them in TorchRL's TED layout, and in Minari's format;
:func:`~bsk_torch.lab.offline.open_dataset` reads them. Since an episode can be copied at any decision, the returns of actions
that were not taken are known (:class:`~bsk_torch.lab.planners.ActionValues`), and off-policy evaluation can be scored against
them.
"""

from bsk_torch.lab.offline.behaviors import Behavior
from bsk_torch.lab.offline.reading import OfflineDataset, open_dataset
from bsk_torch.lab.offline.recipe import Recipe
from bsk_torch.lab.offline.writing import write_dataset

__all__ = ["Behavior", "OfflineDataset", "Recipe", "open_dataset", "write_dataset"]
