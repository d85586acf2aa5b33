"""Kernels whose source is kept in the folder of the cache."""

import pytest
import torch

from bsk_torch.codegen import stored
from bsk_torch.codegen.kernel import Kernel
from bsk_torch.codegen.stored import stored_kernel
from bsk_torch.sim.orbit.builder import KernelBuilder


def test_stored_source(tmp_path, monkeypatch):
    """A process reads what another has traced, unless the file is damaged or the package has changed."""
    monkeypatch.setenv("BSK_TORCH_CACHE", str(tmp_path))
    traced = []

    def times(factor: float) -> Kernel:
        traced.append(factor)
        builder = KernelBuilder()
        (x,) = builder.planes("state", 1)
        return Kernel("product", builder.loop([x * factor], [x], (), "start"))

    def made(factor: float) -> list[float]:
        """Return two steps, and what they write, of a kernel that no process has made."""
        state, written = torch.tensor([[1.0, 2.0]]).double(), torch.empty(2, 2, 1, dtype=torch.float64)
        kernel = stored_kernel(times)(factor)
        kernel(state, 2, (), written=written)
        with pytest.raises(ValueError, match="the product writes 1 numbers a tick"):
            kernel(state, 2, ())
        return [*state.flatten().tolist(), *written.flatten().tolist()]

    def check(steps: list[float]) -> None:
        assert made(3.0) == [9.0, 18.0, 1.0, 3.0, 2.0, 6.0]
        assert traced == steps

    check([3.0])
    check([3.0])
    assert made(2.0)[:2] == [4.0, 8.0]
    check([3.0, 2.0])
    (file,) = tmp_path.glob("*times-3.0.json")
    file.write_bytes(file.read_bytes()[:-1])
    check([3.0, 2.0, 3.0])
    monkeypatch.setattr(stored, "source_hash", lambda: b"of another version")
    check([3.0, 2.0, 3.0, 3.0])
    file.chmod(0o666)
    check([3.0, 2.0, 3.0, 3.0, 3.0])
