"""Devices and memory of the machine."""

from __future__ import annotations

import os
from pathlib import Path

import torch

ROOM = 1.5
"""Ratio of the peak memory of a batch to the memory of its tensors: the first reset and growing arcs copy some tensors."""


def existing_device(device: torch.device | str) -> torch.device:
    """Return the device of that name; ValueError if this machine does not have it, or torch makes tensors without values."""
    check_default_device()
    cuda = torch.cuda.device_count() if torch.cuda.is_available() else 0
    names = ["cpu", *(f"cuda:{k}" for k in range(cuda))]
    try:
        existing = torch.device(device)
    except (RuntimeError, TypeError):
        existing = None
    if existing is None or (existing.type != "cpu" and (existing.type != "cuda" or (existing.index or 0) >= cuda)):
        raise ValueError(f"device={str(device)!r} is not available (available: {', '.join(names)})")
    return existing


def check_default_device() -> None:
    """Raise ValueError if torch makes tensors without values."""
    if torch.get_default_device().type == "meta":
        raise ValueError("torch.set_default_device('meta') makes tensors without values; set it to 'cpu' for environments")


def available_memory(device: torch.device) -> int | None:
    """Return the available memory of a device in bytes; None if the system does not report it."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0] + torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None


def check_memory(device: torch.device, num_envs: int, each: int) -> None:
    """Raise MemoryError if a batch with ``each`` bytes per environment does not fit into the device's memory."""
    available = available_memory(device)
    fits = 0 if available is None else int(available / (ROOM * each))
    if available is not None and num_envs > fits:
        raise MemoryError(
            f"num_envs={num_envs} does not fit into memory: an environment takes {each} bytes, and half as much again for a "
            f"while, but {device} has {available} bytes available; num_envs={fits} is the most that fits"
        )
