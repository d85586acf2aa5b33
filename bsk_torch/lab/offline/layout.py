"""Files, folders and keys of datasets."""

from __future__ import annotations

CARD, TABLE, DESCRIPTION = "dataset.json", "episodes.csv", "croissant.json"
"""Files of a dataset: its card, one row for each episode, and metadata in the format of Croissant."""

TRANSITIONS, COUNTERFACTUALS, STARTS, MINARI = "transitions", "counterfactuals", "starts", "minari"
"""Folders of a dataset: memory-mapped tensordicts, and the root folder of Minari's datasets."""

FORMAT = 1
"""Version of the layout."""

EPISODE, DECISION, INDEX, SEED = "episode", "decision", "index", "seed"
"""Keys of the number of an episode in the dataset, of a decision in the episode, of a row in the transitions, and of the seed of
an episode, [N] int64."""

LOG_PROB = "action_log_prob"
"""Key of the logarithm of the probability with which the behavior chose the action, [N] float32."""

VALUE, ERROR, TARGET_ACTION = "action_value", "standard_error", "target_action"
"""Keys of counterfactual returns, their standard errors, and of the actions of targets; each has an entry for every target."""
