"""Record what bsk_rl's models take for defaults, and what SPICE reads in epochs, as small tables that unit tests compare with.

Usage::

    python scripts/recorders/record_arguments.py                 # both, into tests/sim/data
    python scripts/recorders/record_arguments.py --out FOLDER

Needs the extra ``basilisk`` and its support data; see ``recording.py``.

``default_args.json``
    Arguments by kind (dyn, fsw, world), model and name, in the order in which bsk_rl draws them; ``"drawn"`` stands for a
    function.
``epochs.json``
    ET, s past J2000 TDB, of every form of epochs in ``EPOCHS``, as ``str2et`` of the Basilisk module pyswice returns it; null
    where SPICE raises an error, which ends the process, so that a new process reads each epoch.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from Basilisk.topLevelModules import pyswice
from Basilisk.utilities.supportDataTools.dataFetcher import DataFile, get_path
from bsk_rl.sim import dyn, fsw, world
from bsk_rl.utils.functional import collect_default_args, safe_dict_merge

MODELS = {
    "dyn": (
        "DynamicsModel EclipseDynModel AtmosphericDragDynModel DisturbanceTorqueDynModel BasicDynamicsModel ImagingDynModel "
        "ContinuousImagingDynModel GroundStationDynModel LOSCommDynModel FullFeaturedDynModel"
    ),
    "fsw": "FSWModel BasicFSWModel SteeringFSWModel ContinuousImagingFSWModel ImagingFSWModel SteeringImagerFSWModel",
    "world": "WorldModel EclipseWorldModel AtmosphereWorldModel GroundStationWorldModel",
}

EPOCHS = """
2018 JUN 27 12:00:00.0 (UTC)
2018 JUN 27 12:00:00
2018 Jun 27 12:00
2018 June 27
2018 JUN 27 12
2018 JUN 27 12.5
2018 JUN 27 12:30.5
2018-06-27T12:00:00
2018-06-27T12:00:00Z
2018-06-27T12:00:00.250Z
2018-06-27T12:00
2018-06-27T12
2018-06-27T
2018-06-27
2018-06-27 12:00:00
2018-06-27 12:00:00 UTC
2018-06-27T12:00:00 UTC
2018-6-27 12:00
2018-06-27, 12:00:00
2018-178T12:00:00
2018-178T12:00:00Z
2018-178
2018-178 12:00:00
2018-178//12:00:00
2018-178 // 12:00:00
2018-178/ 12:00:00
2018 178 // 12:00:00
2018 // 178 12:00
178-2018 // 12:00:00
2018/178 12:00:00
2018/06/27 12:00:00.29
06/27/2018 12:00:00
27/06/2018 12:00
6-27-2018 12:00
6/27/18 12:00
18/06/27 12:00
27 JUN 2018 12:00:00
27-Jun-18 12:00:00
27 June 2018, 12:00
June 27, 2018 12:00
June 27, 2018, 12:00:00
Jun. 27, 2018
Wed Jun 27 12:00:00 2018
Wednesday, June 27, 2018 12:00
2018 June 27, 12:00:00 TDB
2018 JUN 27 12:00:00 TDT
2018 JUN 27 12:00:00.0 (TDB)
2018-06-27T12:00:00 TDB
TDB 2018 JUN 27 12:00:00
UTC 2018 JUN 27 12:00:00
JD 2458297.0
JD2458297.0
jd 2458297
2458297.25 JD TDB
JD 2458297.25 TDB
jd 2458297.25 TDT
JDUTC 2458297.0
JDTDB 2458297.0
2458297.0
Mar 2, 2018 11:18:17.287 p.m. PDT
2018 JUN 27 1:00 PM
2018 JUN 27 12:30 A.M.
2018 JUN 27 12:00:00 PST
2018 JUN 27 12:00:00 GMT
2018 JUN 27 12:00:00 UTC+1
2018 JUN 27 12:00:00 UTC-7:30
2018-06-27T12:00:00+01:00
2018 JUN 27 12:00:00 A.D.
A.D. 2018 JUN 27 12:00
18 JUN 27 12:00:00
27 JUN '18
JUN 27, 18 12:00
45 JUN 18
31-Dec-99 12:00
2016 DEC 31 23:59:60.5
2018 JUN 27 24:00:00
2018 JUN 31 12:00:00
12:00 June 27, 2018
2018JUN27 12:00
20180627T120000
2018-06-27T12:00:00.0 (UTC)
2018 JUN 27 - 12:00:00
2018 JUN 27:12:00:00
2018.06.27 12:00:00
2018 JUN 27 12 00 00
2018 6 27 12:00
27 6 2018 12:00
2018 27 JUN 12:00
JUN 2018 27 12:00
2018 Sept 27
2018 Ju 27
2016-366//12:00
2018-366//12:00
2018 JUN 27 13:00 PM
2018-6-27T12:00:00
yesterday
"""


def plain(value: Any) -> Any:
    """Return a value as JSON has it."""
    if callable(value):
        return "drawn"
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(part) for part in value]
    return value.item() if isinstance(value, np.generic) else value


def defaults(kind: str, model: Any) -> dict[str, Any]:
    """Return the default arguments of a model class, as its satellite or environment collects them."""
    if kind == "world":
        return model.default_world_args()
    args = collect_default_args(model)
    for name in dir(model):
        task = getattr(model, name)
        if not name.startswith("__") and inspect.isclass(task) and issubclass(task, fsw.Task):
            args = safe_dict_merge(args, collect_default_args(task))
    return args


def spice(text: str) -> float | None:
    """Return the ET of an epoch, s; None where SPICE ends the process."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        et = pyswice.new_doubleArray(1)
        pyswice.str2et_c(text, et)
        os.write(writing, repr(pyswice.doubleArray_getitem(et, 0)).encode())
        os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    answer = os.read(reading, 100)
    os.close(reading)
    return float(answer) if answer else None


def main() -> None:
    """Write both tables."""
    parser = argparse.ArgumentParser(description="Record default arguments of bsk_rl, and epochs as SPICE reads them.")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[2] / "tests" / "sim" / "data")
    folder = parser.parse_args().out
    warnings.simplefilter("ignore")
    modules = {"dyn": dyn, "fsw": fsw, "world": world}
    found = {
        kind: {name: plain(defaults(kind, getattr(modules[kind], name))) for name in names.split()}
        for kind, names in MODELS.items()
    }
    pyswice.furnsh_c(str(get_path(DataFile.EphemerisData.naif0012)))
    read = {text: spice(text) for text in EPOCHS.strip("\n").split("\n")}
    for name, table in (("default_args", found), ("epochs", read)):
        lines = json.dumps(table, indent=1)
        (folder / f"{name}.json").write_text(f"{lines}\n")
        print(f"{name}.json: {len(lines)} characters")


if __name__ == "__main__":
    main()
