"""Files that are replaced as a whole, and carry a checksum."""

import ast
import errno
import os
import pickle
import random
from pathlib import Path

import pytest
import torch

import bsk_torch
from bsk_torch.files import sweep, write_file
from bsk_torch.rl.policies.checksummed import CHECKSUM_MARK, load_checksummed, save_checksummed
from tests.support.evil import Evil
from tests.support.refusals import check_refusals, refusal

PACKAGE = Path(bsk_torch.__file__).parent

WRITERS = {"files.py", "codegen/build.py", "codegen/prepared.py", "codegen/stored.py"}
"""Modules that write files themselves."""

ENTRIES = {"weights": {"a": torch.arange(600.0), "b": torch.ones(3, dtype=torch.bool)}, "n": 3, "name": "x", "pair": (1, 2.5)}


def test_text_and_bytes_are_written_by_way_of_names_that_cannot_be_foreseen(tmp_path, monkeypatch):
    write_file(tmp_path / "a", "grün\n")
    write_file(tmp_path / "b", b"\x00")
    assert ((tmp_path / "a").read_text(encoding="utf-8"), (tmp_path / "b").read_bytes()) == ("grün\n", b"\x00")
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o666 & ~umask()
    seen, replace = [], os.replace
    monkeypatch.setattr("bsk_torch.files.os.replace", lambda one, other: (seen.append(one.name), replace(one, other)))
    for _ in range(2):
        write_file(tmp_path / "a", "")
    assert len(set(seen)) == 2
    assert all(name.startswith(".a.") for name in seen)


def umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, step):
    (tmp_path / "a").write_text("old")

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(f"bsk_torch.files.os.{step}", full)
    check_refusals(refusal(lambda: write_file(tmp_path / "a", "new"), OSError, "No space left on device", "/a'"))
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "old"}


def test_links_are_never_followed(tmp_path):
    """Neither one at the name of the file, nor one at a name that release 0.1 used while writing."""
    (tmp_path / "precious").write_text("precious")
    for name in ("policy.pt", "policy.part", "checkpoint.pt.part"):
        (tmp_path / name).symlink_to(tmp_path / "precious")
    save_checksummed(tmp_path / "policy.pt", ENTRIES)
    save_checksummed(tmp_path / "checkpoint.pt", ENTRIES)
    assert (tmp_path / "precious").read_text() == "precious"
    assert not (tmp_path / "policy.pt").is_symlink()


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo])
def test_rejects_paths_of_no_ordinary_files(tmp_path, make):
    make(tmp_path / "a")
    check_refusals(refusal(lambda: write_file(tmp_path / "a", "new"), OSError, "ordinary file"))
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_only_unfinished_files_are_swept(tmp_path):
    kept = {"a.part", ".a.part", ".a.0123456789abcdef.parts", "policy.pt"}
    for name in (*kept, ".policy.pt.0123456789abcdef.part"):
        (tmp_path / name).touch()
    sweep(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == kept


def test_nothing_in_the_package_writes_files_in_another_way():
    found = [f"{path.relative_to(PACKAGE)}:{line}" for path in PACKAGE.rglob("*.py") for line in writes(path)]
    assert [place for place in found if place.split(":")[0] not in WRITERS] == []


def writes(path):
    """Lines that write a file by its name."""
    for call in (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)):
        name = getattr(call.func, "attr", getattr(call.func, "id", ""))
        words = [node.value for node in (*call.args, *(k.value for k in call.keywords)) if isinstance(node, ast.Constant)]
        opened = name == "open" and any(isinstance(word, str) and set(word) & set("wax+") and len(word) < 4 for word in words)
        descriptor = bool(call.args) and isinstance(call.args[0], ast.Call)  # of os.open, with flags of its own
        by_name = name == "savefig" and not (isinstance(call.args[0], ast.Name) and call.args[0].id == "drawn")
        torch_save = ast.unparse(call.func) == "torch.save" and ast.unparse(call.args[1]) != "buffer"
        if name in ("write_text", "write_bytes", "copyfile") or (opened and not descriptor) or by_name or torch_save:
            yield call.lineno


@pytest.fixture
def saved_file(tmp_path):
    save_checksummed(tmp_path / "x.pt", ENTRIES)
    return tmp_path / "x.pt"


def test_saved_entries_come_back(saved_file):
    read = load_checksummed(saved_file, "policy")
    assert read.keys() == ENTRIES.keys()
    assert read["weights"]["a"].equal(ENTRIES["weights"]["a"])
    assert (read["n"], read["name"], read["pair"]) == (3, "x", (1, 2.5))
    assert torch.load(saved_file, weights_only=True).keys() == ENTRIES.keys()


def test_every_flipped_bit_is_noticed(saved_file):
    content, draw = saved_file.read_bytes(), random.Random(0)
    end = len(content) - 32 - len(CHECKSUM_MARK)
    places = [*(draw.randrange(8 * len(content)) for _ in range(200)), *range(8 * end, 8 * len(content), 5)]
    assert len(places) > 250
    for place in places:
        changed = bytearray(content)
        changed[place // 8] ^= 1 << place % 8
        saved_file.write_bytes(changed)
        with pytest.raises(ValueError, match=r"x\.pt' is a damaged policy"):
            load_checksummed(saved_file, "policy")


def test_rejects_truncated_files(saved_file):
    def cut(size):
        saved_file.write_bytes(content[:size])
        load_checksummed(saved_file, "policy")

    content, draw = saved_file.read_bytes(), random.Random(0)
    sizes = [0, 1, *(draw.randrange(len(content)) for _ in range(50)), *range(len(content) - 60, len(content))]
    check_refusals(refusal(lambda size=size: cut(size), ValueError, "x.pt", "policy") for size in sizes)


def test_files_of_release_0_1_are_read_with_a_warning_and_their_parts_compared(tmp_path, caplog):
    path = tmp_path / "x.pt"
    torch.save(ENTRIES, path)
    assert load_checksummed(path, "policy")["n"] == 3
    assert "has no checksum" in caplog.text
    content = bytearray(path.read_bytes())
    content[content.index(torch.arange(600.0).numpy().tobytes()) + 100] ^= 1
    path.write_bytes(content)
    check_refusals(refusal(lambda: load_checksummed(path, "policy"), ValueError, "damaged"))


def test_nothing_in_a_file_is_executed(tmp_path):
    path, made = tmp_path / "x.pt", tmp_path / "made"
    contents = [pickle.dumps(Evil(made))]
    torch.save({"n": Evil(made)}, path)
    contents.append(path.read_bytes())
    save_checksummed(path, {"n": Evil(made)})  # a checksum tells damage, not origin
    contents.append(path.read_bytes())
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(ValueError, match="is no file of a policy"):
            load_checksummed(path, "policy")
    assert not made.exists()


def test_rejects_other_formats(tmp_path, monkeypatch):
    newer, other = tmp_path / "newer.pt", tmp_path / "other.pt"
    monkeypatch.setattr("bsk_torch.rl.policies.checksummed.VERSION", b"3")
    save_checksummed(newer, ENTRIES)
    monkeypatch.undo()
    torch.save([1], other)
    check_refusals(
        refusal(lambda: load_checksummed(newer, "policy"), ValueError, "newer.pt", "policy", b"3", b"2"),
        refusal(lambda: load_checksummed(other, "policy"), ValueError, "other.pt", "policy", "list"),
    )
