"""The same results on all x86-64 processors with AVX2: the environment variable ``BSK_TORCH_PORTABLE``.

NumPy, torch and their matrix libraries choose instructions by the processor when they are first used, so that a process is
portable as a whole or not at all. The package, imported first, makes the choice for them. Its kernels then have no fused
products, which compilers place as they like, and no instructions beyond AVX2.
"""

from __future__ import annotations

import os
import sys
import warnings

VARIABLE = "BSK_TORCH_PORTABLE"

SETTINGS = {
    "ATEN_CPU_CAPABILITY": "avx2",
    "MKL_CBWR": "COMPATIBLE",  # torch's matrix products: the one code that processors of Intel and AMD share
    "OPENBLAS_CORETYPE": "Haswell",  # NumPy's
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",  # its sines with AVX-512 differ from others in the last digit
    "BSK_TORCH_ISA": "avx2",
}
"""Variables of the environment, read by torch, MKL, OpenBLAS, NumPy and this package."""


APPROXIMATED = {"acos": "arccos", "asin": "arcsin", "atan": "arctan"} | {
    name: name for name in ("log", "log10", "log2", "sqrt", "tan")
}
"""Functions for which MKL, in whatever mode, uses approximate reciprocals, whose last digits differ among processors: names of
torch, and of NumPy, whose functions take their place."""

LIBRARIES: list[object] = []
"""What registers these functions, as long as it exists."""


def is_portable() -> bool:
    """Return whether the process gives the same results on other processors; the variable, set later, changes nothing."""
    return bool(LIBRARIES)


def choose_instructions() -> None:
    """Set :data:`SETTINGS` if the process is to be portable.

    Raises:
        ImportError: If NumPy has been imported, and has chosen its instructions.
    """
    if not os.environ.get(VARIABLE):
        return
    missing = {name: value for name, value in SETTINGS.items() if os.environ.get(name) != value}
    if missing and "numpy" in sys.modules:
        variables = " ".join(f"{name}='{value}'" for name, value in missing.items())
        raise ImportError(
            f"{VARIABLE} is set, but NumPy was imported first; import bsk_torch before it, or start with {variables}"
        )
    os.environ.update(missing)
    share_functions()


def share_functions() -> None:
    """Let torch compute :data:`APPROXIMATED` functions on CPUs with NumPy's."""
    import numpy as np
    import torch
    from torch import Tensor

    library = torch.library.Library("aten", "IMPL")
    LIBRARIES.append(library)

    def replace(name: str, function: np.ufunc) -> None:
        def into(x: Tensor, *, out: Tensor) -> Tensor:
            out = out if out.shape == x.shape else out.resize_(x.shape)
            function(x.detach().numpy(), out=out.detach().numpy())
            return out

        def new(x: Tensor) -> Tensor:
            x = x if x.is_floating_point() else x.to(torch.get_default_dtype())
            return into(x, out=torch.empty_like(x))

        for overload, kernel in ((name, new), (f"{name}_", lambda x: into(x, out=x)), (f"{name}.out", into)):
            library.impl(overload, kernel, "CPU", allow_override=True)

    with warnings.catch_warnings():  # of one kernel that replaces another
        warnings.simplefilter("ignore", UserWarning)
        for name, of_numpy in APPROXIMATED.items():
            replace(name, getattr(np, of_numpy))
