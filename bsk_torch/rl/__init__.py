"""Training with TorchRL components, evaluation, and baselines."""
