import logging

import pytest
import torch

from bsk_torch.codegen.inductor import just_in_time
from bsk_torch.vec3 import Vec3


@pytest.mark.compiled
def test_functions_are_compiled_once_for_every_set_of_shapes(caplog):
    """Whatever Python they are written in, and with the tensors that they hold."""
    held = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)

    def function(r: torch.Tensor, factor: torch.Tensor) -> torch.Tensor:
        return torch.stack(list(Vec3(*r.unbind(0)) * factor + Vec3(*held)))

    fast = just_in_time(function, "sum")
    with caplog.at_level(logging.INFO, logger="bsk_torch"):
        for n in (4, 5, 4, 4):
            r, factor = torch.randn(3, n, dtype=torch.float64), torch.rand(n, dtype=torch.float64)
            torch.testing.assert_close(fast(r, factor), function(r, factor), rtol=1e-15, atol=1e-15)
    assert sum("compiled the sum in" in record.message for record in caplog.records) == 2
