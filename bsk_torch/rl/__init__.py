"""Learning recipes on TorchRL's own parts, evaluation, and baselines to compare with."""
