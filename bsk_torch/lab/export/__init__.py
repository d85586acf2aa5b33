"""Trained policies for programs without this package: ONNX, ``torch.export`` and C, each with its contract."""

from bsk_torch.lab.export.export import export_policy

__all__ = ["export_policy"]
