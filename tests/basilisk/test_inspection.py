"""Inspection of an RSO: replays of bsk_rl's episodes on Basilisk."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.basilisk.inspection import environment, load, padded, replay
