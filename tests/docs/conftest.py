"""The site, built once for the tests of its pages, without running tutorials, and without sidebars of the reference."""

import os
import subprocess
import sys

import pytest

from tests.support.blocks import ROOT


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """Folder of the site; a warning of Sphinx is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q", "-d", str(folder / "doctrees")]
    environment = os.environ | {"BSK_TORCH_DOCS_QUICK": "1", "BSK_TORCH_DOCS_BARE": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run([*command, "docs", str(folder / "html")], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
    return folder / "html"
