"""The cache of kernels: where it is, whom it is taken from, and what killed builds leave."""

import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bsk_torch.codegen import build, cache
from tests.codegen.test_kernel import SOURCE, START
from tests.support.refusals import check_refusals, refusal

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(os.name != "posix", reason="owners and modes of other systems are not checked"),
]

ROOT = os.name == "posix" and os.geteuid() == 0
as_root = pytest.mark.skipif(not ROOT, reason="only root can give files to others")

PLANTED = SOURCE.replace("42", "666")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache that does not exist yet, of which this process has loaded nothing."""
    place = tmp_path / "cache"
    monkeypatch.setenv("BSK_TORCH_CACHE", str(place))
    monkeypatch.setattr(build, "LOADED", {})
    cache.sweep.cache_clear()
    return place


def load(monkeypatch, source=SOURCE):
    monkeypatch.setattr(build, "LOADED", {})
    return build.load(source, "test kernel").lanes_width()


@pytest.fixture
def planted(folder, monkeypatch, tmp_path):
    """A library with a right seal that gives a wrong answer, under the name of the right one; the cache is empty."""
    made = []
    for name, source in (("right", SOURCE), ("wrong", PLANTED)):  # a process loads what lies at one path only once
        monkeypatch.setenv("BSK_TORCH_CACHE", str(tmp_path / name))
        load(monkeypatch, source)
        made += (tmp_path / name).iterdir()
    monkeypatch.setenv("BSK_TORCH_CACHE", str(folder))
    folder.mkdir(mode=0o700)
    code, library = made[1].read_bytes()[:-32], tmp_path / "wrong" / made[0].name  # another file: that one is loaded
    library.write_bytes(code + build._seal(library.name, code))
    library.chmod(0o700)
    return library


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("umask", [0o022, 0o000])
def test_folders_and_libraries_are_private(folder, monkeypatch, umask):
    before = os.umask(umask)
    try:
        assert load(monkeypatch) == 42
    finally:
        os.umask(before)
    assert mode(folder) == 0o700
    assert [mode(path) for path in folder.iterdir()] == [0o700]


def test_planted_libraries_run_where_everything_is_the_user_s(planted, folder, monkeypatch):
    """What the other tests refuse does work: the seal of the planted library is right."""
    planted.rename(folder / planted.name)
    assert load(monkeypatch) == 666


@pytest.mark.parametrize("writable", [0o777, 0o1777, 0o770, 0o702])
def test_folders_that_others_may_write_to_are_refused(planted, folder, monkeypatch, writable):
    planted.rename(folder / planted.name)
    folder.chmod(writable)
    check_refusals(refusal(lambda: load(monkeypatch), PermissionError, "other users", "mode", "BSK_TORCH_CACHE"))
    assert mode(folder) == writable
    folder.chmod(0o755)
    assert load(monkeypatch) == 666  # as older releases made it: others may read


def test_a_new_library_is_not_put_into_a_folder_of_others(folder, monkeypatch):
    folder.mkdir()
    folder.chmod(0o777)
    check_refusals(refusal(lambda: load(monkeypatch), PermissionError, "other users"))
    assert not list(folder.iterdir())


@as_root
def test_folders_of_others_are_refused(planted, folder, monkeypatch):
    planted.rename(folder / planted.name)
    os.chown(folder, 1234, 1234)
    check_refusals(refusal(lambda: load(monkeypatch), PermissionError, folder, "user 1234", "BSK_TORCH_CACHE"))


@as_root
def test_libraries_of_others_are_built_again(planted, folder, monkeypatch, caplog):
    planted.rename(folder / planted.name)
    os.chown(folder / planted.name, 1234, 1234)
    assert load(monkeypatch) == 42
    assert "belongs to user 1234, not to you (0); it is not used and will be built again" in caplog.text
    assert (folder / planted.name).stat().st_uid == 0


def test_libraries_that_others_may_write_to_and_folders_in_their_place_are_built_again(planted, folder, monkeypatch, caplog):
    planted.rename(folder / planted.name).chmod(0o775)
    assert load(monkeypatch) == 42
    assert "may be written to by other users (mode 0775)" in caplog.text
    (folder / planted.name).unlink()
    (folder / planted.name / "within").mkdir(parents=True)
    assert load(monkeypatch) == 42
    assert "is no ordinary file" in caplog.text
    assert [path.name for path in folder.iterdir()] == [planted.name]


@pytest.mark.parametrize("make", [Path.symlink_to, Path.hardlink_to], ids=["symbolic", "hard"])
def test_links_are_not_followed(planted, folder, monkeypatch, make):
    """Nor written through: what a link points to stays."""
    content = planted.read_bytes()
    planted.chmod(0o777)
    make(folder / planted.name, planted)
    assert load(monkeypatch) == 42
    assert not (folder / planted.name).is_symlink()
    assert planted.read_bytes() == content


def test_things_that_are_no_files_are_not_read(planted, folder, monkeypatch):
    """A pipe would keep the reader waiting for ever."""
    os.mkfifo(folder / planted.name)
    assert load(monkeypatch) == 42


def test_the_user_s_own_cache_is_closed(planted, folder, monkeypatch):
    """One that an older release made under a lenient umask; its libraries are checked one by one."""
    planted.rename(folder / planted.name).chmod(0o775)
    folder.chmod(0o775)
    monkeypatch.delenv("BSK_TORCH_CACHE")
    monkeypatch.setattr(cache.platformdirs, "user_cache_path", lambda name: folder)
    assert (load(monkeypatch), mode(folder)) == (42, 0o700)


@as_root
def test_caches_of_root_are_shared_by_all(folder, monkeypatch):
    """Root makes it readable; a user loads from it and cannot write."""
    load(monkeypatch)
    folder.chmod(0o755)
    for parent in folder.parents[:3]:
        parent.chmod(0o755)
    (library,) = folder.iterdir()
    library.chmod(0o755)
    check = f"""{START}
import os
from bsk_torch.codegen import cache
os.setuid(1234)
path = cache.Path(sys.argv[1])
cache.check_owner(path.parent)
print(len(cache.read_trusted(path)))
"""
    command = [sys.executable, "-c", check, str(library)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    if "PermissionError" in run.stderr and str(folder) in run.stderr:
        pytest.skip("the folder of temporary files is closed to other users")
    assert run.stdout == f"{library.stat().st_size}\n", run.stderr


PATHS = [".", "relative/deep", "~/kernels", "with space", 'quote\'d "twice"', "ünïcödé 軌道", "$HOME;echo", "..", "-dash"]


FROM_PATHS = f"""{START}
import os
for given in sys.argv[1:]:
    os.environ["BSK_TORCH_CACHE"] = given
    for again in range(2):
        build.LOADED.clear()
        print(build.load({SOURCE!r}, "test kernel").lanes_width())
"""


def test_paths(tmp_path):
    """Built and loaded, with a working directory and its own home."""
    work, home = tmp_path / "work" / "inner", tmp_path / "home"
    work.mkdir(parents=True), home.mkdir()
    env = os.environ | {"HOME": str(home), "BSK_TORCH_ISA": "default"}
    command = [sys.executable, "-c", FROM_PATHS, *PATHS]
    run = subprocess.run(command, cwd=work, env=env, capture_output=True, text=True, check=False)
    assert run.stdout == 2 * len(PATHS) * "42\n", run.stderr
    for given in PATHS:
        expected = home / given[2:] if given.startswith("~") else work / given
        assert [path.suffix for path in expected.iterdir() if path.is_file()] == [".so"]


SLOW = f"""{START}
build._command = lambda name: ["sleep", "60"]
build.load({SOURCE!r}, "test kernel")
"""


def start_slow_build(folder):
    """A process that is building; its folder."""
    before = set(folder.glob("build-*"))
    env = os.environ | {"BSK_TORCH_CACHE": str(folder)}
    process = subprocess.Popen([sys.executable, "-c", SLOW], env=env, stderr=subprocess.DEVNULL, start_new_session=True)
    while not (made := {lock.parent for lock in folder.glob("build-*/lock")} - before):
        assert process.poll() is None
        time.sleep(0.05)
    return process, made.pop()


def test_folders_of_killed_builds_are_swept_and_those_of_living_ones_kept(folder, monkeypatch):
    (dead, _), (alive, kept) = start_slow_build(folder), start_slow_build(folder)
    try:
        os.killpg(dead.pid, signal.SIGKILL)
        dead.wait()
        old = folder / "build-of-an-older-release"
        old.mkdir()
        os.utime(old, (time.time() - 7200, time.time() - 7200))
        begins = folder / "build-that-begins-now"
        begins.mkdir()
        assert (load(monkeypatch), set(folder.glob("build-*"))) == (42, {kept, begins})
    finally:
        os.killpg(alive.pid, signal.SIGKILL)
        alive.wait()
    cache.sweep.cache_clear()
    assert load(monkeypatch) == 42  # from the cache
    assert list(folder.glob("build-*")) == [begins]
