"""The windows that close next, by a kernel that reads no more of each row than it needs.

It is written in C++, not traced: kernels that are traced compute numbers element by element, and this is a search in sorted rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from bsk_torch.codegen.build import entry, load
from bsk_torch.sim.access.windows.table import TIME_ROUNDING, Windows, is_long
from bsk_torch.sim.hooks import check_tensor

SOURCE = Path(__file__).with_name("next_windows.cpp")

SIGNATURE = "iip" + "ippp" + "pppi" + "iip" + "pppp"

ROUNDING = torch.tensor(TIME_ROUNDING, dtype=torch.float64)

ROWS_OF_A_THREAD = 512  # rows below which a further thread would take longer to start than to run


@cache
def next_windows_kernel() -> Callable[..., None]:
    """Return the kernel, built or loaded when it is first needed."""
    return entry(load(SOURCE.read_text(), "search for the next windows"), SIGNATURE)


def check_times(shape: torch.Size, times: Mapping[str, Tensor | None]) -> None:
    """Raise TypeError for times of another shape, or that are not float64: kernels read addresses."""
    for name, tensor in times.items():
        if tensor is not None and (tensor.shape != shape or tensor.dtype != torch.float64):
            check_tensor(name, tensor, shape, torch.float64)


def next_windows(
    windows: Windows, time: Tensor, until: Tensor, width: int, allowed: Tensor | None, rows: Tensor | None = None
) -> tuple[Windows, Tensor]:
    """Return the same as :func:`~bsk_torch.sim.access.windows.table.next_to_close`, bit for bit, of ``rows`` [n], or of all.

    The first windows that have not closed and are not cut come in the order of the table; only where they are too few, those
    that are cut are sorted. TypeError for times that are not float64, or of another shape than the table's: kernels read
    addresses.
    """
    shape = windows.close.shape
    check_times(shape, {"windows.open": windows.open, "windows.close": windows.close})
    check_times(shape[:1], {"time": time, "until": until})
    n, columns = len(time) if rows is None else len(rows), shape[1]
    opens, close = time.new_empty(n, width), time.new_empty(n, width)
    place, number = windows.place.new_empty(n, width), windows.place.new_empty(n)
    places = 0 if allowed is None else allowed.shape[1]
    next_windows_kernel()(
        n, max(1, min(n // ROWS_OF_A_THREAD, torch.get_num_threads())), None if rows is None else rows.contiguous(),
        columns, windows.open.contiguous(), windows.close.contiguous(), windows.place.contiguous(),
        time.contiguous(), until.contiguous(), None if allowed is None else allowed.contiguous(), places,
        width, is_long(columns, width), ROUNDING,
        opens, close, place, number,
    )  # fmt: skip
    return Windows(opens, close, place), number
