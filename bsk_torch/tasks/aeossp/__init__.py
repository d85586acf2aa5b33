"""Cases of aeossp_standard, a benchmark of scheduling with real satellites: reading, checking, planning, and solutions."""

from bsk_torch.tasks.aeossp.files import Case, CaseSatellite, Observations, Requests, read_case, read_solution, write_solution

__all__ = ["Case", "CaseSatellite", "Observations", "Requests", "read_case", "read_solution", "write_solution"]
