"""Files of others: no reader executes anything in them, and bounds are checked before anything is allocated."""

import ast
import gzip
import io
import json
import pickle
import shutil
import zipfile
from pathlib import Path

import pytest
import torch
from tensordict import NonTensorData, TensorDict

from bsk_torch.lab.offline import open_dataset
from bsk_torch.untrusted import MOST_ERRORS, Json, gunzip, parse_json, read_memmap, read_tensors
from tests.support.evil import Evil
from tests.support.readers import CARD, readers, write_dataset_rows
from tests.support.refusals import check_refusals, refusal

PACKAGE = Path(__file__).parents[1] / "bsk_torch"


def planted(made):
    """Files that execute code where they are unpickled: pickles, and both formats of torch."""
    yield pickle.dumps(Evil(made), 4)
    for new in (True, False):
        file = io.BytesIO()
        torch.save({"n": Evil(made)}, file, _use_new_zipfile_serialization=new)
        yield file.getvalue()
    yield gzip.compress(pickle.dumps(Evil(made)))
    yield f"!!python/object/apply:os.mkdir ['{made}']".encode()
    yield f"preset: !!python/object/apply:os.mkdir ['{made}']".encode()


@pytest.mark.parametrize("name", readers())
def test_planted_code_is_not_executed(name, tmp_path):
    reader, made = readers()[name], tmp_path / "made"
    for content in planted(made):
        with pytest.raises(ValueError, match=r"\S"):
            reader.of(tmp_path, content + b"\n" * (name == "log"))  # which has lines
    assert not made.exists()
    reader.of(tmp_path, reader.content)


@pytest.mark.parametrize("folder", ["a/transitions", "starts", "a/counterfactuals"])
def test_pickles_in_datasets_are_not_executed(folder, tmp_path):
    made = tmp_path / "made"
    write_dataset_rows(tmp_path)
    rows = {"episode": torch.zeros(3, dtype=torch.int64), "seed": torch.zeros(3, dtype=torch.int64)}
    shutil.rmtree(tmp_path / folder, ignore_errors=True)
    TensorDict(rows | {"note": NonTensorData(Evil(made), batch_size=[3])}, [3]).memmap(tmp_path / folder)
    shutil.rmtree(made, ignore_errors=True)  # writing does not count
    (tmp_path / "dataset.json").write_text(json.dumps(CARD))
    data = open_dataset(tmp_path)
    read = {"a/transitions": data.transitions, "starts": data.starts, "a/counterfactuals": data.counterfactuals}[folder]
    check_refusals(refusal(lambda: read(), ValueError, "'note'"))
    assert not made.exists()


def test_folders_of_datasets_stay_inside(tmp_path):
    def opened(folder):
        card = CARD | {"behaviors": {"a": {"folder": folder, "episodes": 1}}}
        (tmp_path / "d" / "dataset.json").write_text(json.dumps(card))
        return open_dataset(tmp_path / "d").transitions()

    (tmp_path / "d").mkdir()
    write_dataset_rows(tmp_path / "d")
    write_dataset_rows(tmp_path)
    (tmp_path / "d" / "link").symlink_to(tmp_path / "a")
    assert len(opened("a")) == 3
    outside = (str(tmp_path / "a"), "../a", "a/../../a", "..", ".", "", "link")
    check_refusals(refusal(lambda name=name: opened(name), ValueError, "dataset.json", f"folder={name!r}") for name in outside)


def test_memory_mapped_rows_are_as_large_as_their_files(tmp_path):
    def with_meta(change):
        shutil.rmtree(tmp_path / "a", ignore_errors=True)
        write_dataset_rows(tmp_path)
        path = tmp_path / "a" / "transitions" / "meta.json"
        meta = json.loads(path.read_text())
        change(meta)
        path.write_text(json.dumps(meta))
        return read_memmap(path.parent)

    def shape(name, value):
        return lambda meta: meta[name].update(shape=value)

    assert with_meta(lambda meta: None)["observation"].shape == (3, 2)
    size = (tmp_path / "a" / "transitions" / "observation.memmap").stat().st_size
    check_refusals(
        refusal(lambda: with_meta(shape("observation", [3, 2 * 10**12])), ValueError, "transitions", "'observation'", "24 bytes"),
        refusal(lambda: with_meta(shape("observation", [4, 2])), ValueError, "transitions", [4, 2], [3]),
        refusal(lambda: with_meta(shape("observation", [3, -2])), ValueError, "transitions", [3, -2]),
        refusal(lambda: with_meta(shape("observation", [3, 0])), ValueError, "'observation'"),
        refusal(lambda: with_meta(lambda meta: meta.update(shape=[10**15])), ValueError, "transitions", [10**15]),
        refusal(lambda: with_meta(lambda meta: meta.update(_type="<class 'x'>")), ValueError, "transitions", "class 'x'"),
        refusal(lambda: with_meta(lambda meta: meta.update(device="cuda:99")), ValueError, "transitions", "cuda:99"),
        refusal(lambda: with_meta(lambda meta: meta["observation"].update(is_nested=True)), ValueError, "'observation'"),
        refusal(lambda: with_meta(lambda meta: meta["observation"].update(dtype="torch.load")), ValueError, "'observation'"),
    )
    assert (tmp_path / "a" / "transitions" / "observation.memmap").stat().st_size == size  # none is extended


def archive(values, method=zipfile.ZIP_STORED):
    """What torch saves, packed in another way."""
    file, packed = io.BytesIO(), io.BytesIO()
    torch.save(values, file)
    with zipfile.ZipFile(file) as source, zipfile.ZipFile(packed, "w", method) as target:
        for name in source.namelist():
            target.writestr(name, source.read(name))
    return packed.getvalue()


def test_small_archives_of_tensors_stay_small():
    assert torch.equal(read_tensors(archive({"w": torch.ones(3)}))[0]["w"], torch.ones(3))
    check_refusals(
        refusal(lambda: read_tensors(archive({"w": torch.zeros(10**6)}, zipfile.ZIP_DEFLATED)), ValueError, "own size"),
        refusal(lambda: read_tensors(archive({"w": torch.zeros(1).expand(10**12)})), ValueError, "4,000,000,000,000 bytes"),
        refusal(
            lambda: read_tensors(archive([torch.zeros(9)] + [torch.zeros(10**4)[:1].expand(10**4)] * 9)), ValueError, "bytes"
        ),
        refusal(lambda: read_tensors(archive({"w": torch.zeros(2, 2).to_sparse()})), ValueError, "plain"),
        refusal(lambda: read_tensors(archive({"w": torch.zeros(10**9, device="meta")})), ValueError, "bytes"),
        refusal(
            lambda: read_tensors(archive({"w": torch.quantize_per_tensor(torch.zeros(2), 1, 0, torch.qint8)})),
            ValueError,
            "plain",
        ),
        refusal(lambda: read_tensors(b""), ValueError, "zip"),
    )


def test_json_and_packed_bytes_have_bounds():
    many = b"[" + b'"x",' * (MOST_ERRORS + 1) + b'"x"]'
    check_refusals(
        refusal(lambda: parse_json(b"[" * 5000, Json), ValueError, "recursion limit"),
        *(refusal(lambda text=text: parse_json(text, Json), ValueError, "number") for text in (b"NaN", b"[1e999]", b"1" * 400)),
        refusal(lambda: parse_json(b"9" * 10**6, Json), ValueError, "number"),
        refusal(lambda: parse_json(b'"\xff"', Json), ValueError, "unicode"),
        refusal(lambda: parse_json(b'{"a": Infinity}', dict[str, float]), ValueError, "a=inf", "finite"),
        refusal(lambda: parse_json(b'{"a": "1"}', dict[str, float]), ValueError, "a='1'", "number"),
        refusal(lambda: parse_json(many, list[int]), ValueError, f"{MOST_ERRORS + 2:,} of its entries"),
    )
    packed = gzip.compress(bytes(10**6))
    assert gunzip(packed, 10**6) == bytes(10**6)
    check_refusals(
        refusal(lambda: gunzip(packed, 10**6 - 1), ValueError, "999,999 bytes"),
        refusal(lambda: gunzip(packed[:-1], 10**6), EOFError),
        refusal(lambda: gunzip(packed + b"x", 10**6), ValueError, "end"),
        refusal(lambda: gunzip(b"xx", 10**6), ValueError, "header"),
    )


OWN_FILES = {"_listed.py", "cli/presets.py", "lab/suites/suite.py", "viewer/page.py", "viz/figures/world.py", "codegen/stored.py"}
"""Modules that read JSON files of the package itself, or such as it has written, sealed, into its cache."""

TRUSTED = {"rl/policies/network_files.py", "rl/policies/sb3_zip.py", "rl/marl/benchmarl.py"}
"""Modules with readers that unpickle; ``KINDS`` of policies says what they execute, and asks for trust before."""

LOADERS = {
    "torch.load": {"untrusted.py", *TRUSTED},
    "TensorDict.load_memmap": {"untrusted.py"},
    "gzip.decompress": set(),
    "json.load": set(),
    "json.loads": OWN_FILES,
    "np.load": {"tasks/aeos_bench/generator.py", "astro/ephemeris.py"},  # tables of the package
    **{
        f"{module}.{name}": TRUSTED if module == "pickle" else set()
        for module in ("pickle", "cPickle", "marshal", "dill", "joblib")
        for name in ("load", "loads", "Unpickler")
    },
    **{f"yaml.{name}": set() for name in ("load", "unsafe_load", "full_load", "load_all")},
    **{name: set() for name in ("eval", "exec", "numpy.load", "torch.jit.load", "torch.package.PackageImporter", "shelve.open")},
}
"""Functions that may execute what they read, or read it without bounds, with the modules that may call them."""


def test_readers_go_through_one_door():
    found = set()
    words = {name.rpartition(".")[2] for name in LOADERS} | {"allow_pickle"}
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text()
        tree = ast.parse(text if any(f"{word}(" in text or f"{word}=" in text for word in words) else "")
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            name, module = ast.unparse(call.func), path.relative_to(PACKAGE).as_posix()
            if name in LOADERS and module not in LOADERS[name]:
                found.add(f"{module}:{call.lineno} {name}")
            given = {word.arg: ast.unparse(word.value) for word in call.keywords}
            if given.get("allow_pickle", "False") != "False" or (
                name == "torch.load" and given.get("weights_only") != "True" and module not in TRUSTED
            ):
                found.add(f"{module}:{call.lineno} {name} unpickles")
    assert not found
