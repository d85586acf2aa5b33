"""Every package, and every module of rl, can be the first one that is imported."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]

FILES = sorted({*(ROOT / "bsk_torch").rglob("__init__.py"), *(ROOT / "bsk_torch" / "rl").rglob("*.py")})

MODULES = [".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in FILES]

CODE = """
import importlib, os, sys
import omegaconf, torchrl.envs, torchrl.objectives, torchrl.collectors, yaml  # once for all

def import_below(package):
    # Python imports the packages that contain a module before it, so the process of a module is a copy of its package's
    for module in sys.argv[1:]:
        if module.rpartition(".")[0] != package:
            continue
        child = os.fork()
        if not child:
            try:
                importlib.import_module(module)
                print("ok", module, flush=True)
                import_below(module)
            except BaseException as error:
                print(module, repr(error), flush=True)
            os._exit(0)
        os.waitpid(child, 0)

import_below("")
"""


def test_modules_can_be_imported_first():
    assert len(MODULES) >= 50
    run = subprocess.run([sys.executable, "-c", CODE, *MODULES], capture_output=True, text=True, check=True)
    assert sorted(run.stdout.splitlines()) == [f"ok {module}" for module in sorted(MODULES)]


def test_modules_of_sim_can_be_imported_first_from_the_package():
    code = "from bsk_torch import dyn, faults, fsw; print(dyn.Wheel.__name__, faults.Fault.__name__, fsw.Mode.__name__)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["Wheel", "Fault", "Mode"]
