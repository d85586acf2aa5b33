"""Nothing depends on torch's default type, which programs and other libraries set."""

import ast
import dataclasses
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import bsk_torch
from bsk_torch.rl.networks import AttentionPlan, GRUPlan, MLPPlan
from bsk_torch.rl.policies import pretrained
from bsk_torch.rl.training import train
from tests.env.default_dtype import CASES, Made
from tests.rl.test_training import TINY, weights

PROGRAM = Path(__file__).with_name("default_dtype.py")

TYPES = "bfloat16", "float16", "float64"

PACKAGE = Path(bsk_torch.__file__).parent

ROOT = Path(__file__).parents[2]

SOME = ["scanning, eager", "constellation", "inspection"]

FLOATING = {"zeros", "ones", "empty", "eye", "linspace", "logspace", "rand", "randn", "normal", "scalar_tensor"}
"""Functions of torch whose result has the default type unless another is named."""

FILLED = {"full", "tensor", "as_tensor", "arange"}
"""Functions whose result has it where they are given Python's floating-point numbers."""


@pytest.fixture
def default(request):
    """Another default type during a test."""
    torch.set_default_dtype(request.param)
    yield request.param
    torch.set_default_dtype(torch.float32)


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Everything that episodes of cases show and keep under a default type."""
    known = {}

    def play(dtype, cases):
        missing = [case for case in cases if (dtype, case) not in known]
        if missing:
            folder = tmp_path_factory.mktemp(dtype)
            command = [sys.executable, str(PROGRAM), dtype, "found.pt", *missing]  # imports the package under the type
            surroundings = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
            done = subprocess.run(command, cwd=folder, env=surroundings, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr[-2000:]
            known.update({(dtype, case): found for case, found in torch.load(folder / "found.pt").items()})
        return {case: known[dtype, case] for case in cases}

    return play


def digest(tensor):
    return str(tensor.dtype), tuple(tensor.shape), hashlib.sha256(tensor.contiguous().numpy().tobytes()).hexdigest()


@pytest.mark.compiled
@pytest.mark.nightly("cases1", "cases2", "cases3")
@pytest.mark.parametrize(("dtype", "cases"), [("bfloat16", SOME), *((name, [*CASES]) for name in TYPES)])
def test_episodes_are_the_same_under_every_default_type(played, dtype, cases):
    expected, found = played("float32", cases), played(dtype, cases)
    assert cases
    for case in cases:
        made = found[case].get("made", {})
        assert not made, f"{case}: tensors of the default type are made in {made}"
        one, other = ({key: digest(value) for key, value in part[case].items() if key != "made"} for part in (expected, found))
        assert one.keys() == other.keys()
        assert not [key for key in one if one[key] != other[key]], case


def test_the_program_sees_tensors_of_the_default_type():
    whole = torch.arange(3)
    with Made(torch.float32) as made:
        bsk_torch.vec3.Vec3(*whole).dot(bsk_torch.vec3.Vec3(0.5, 0.5, 0.5))
    assert made.found


@pytest.mark.parametrize("default", [torch.bfloat16, torch.float64], indirect=True)
@pytest.mark.parametrize(
    "plan",
    [
        MLPPlan(4, 3, (8, 8)),
        MLPPlan(4, 0, (8, 8), ((-1.0, 1.0), (0.0, 2.0))),
        GRUPlan(4, 3, (8, 8)),
        AttentionPlan(("observation", "target"), (("observation", "time"),), 1, 4, 5, (1, 5), (32, 32)),
    ],
    ids=lambda plan: type(plan).__name__,
)
def test_weights_are_float32_and_do_not_depend_on_it(default, plan):
    torch.manual_seed(3)
    found = plan.build()
    parts = [found.normaliser, found.actor, found.critic]
    torch.set_default_dtype(torch.float32)
    torch.manual_seed(3)
    known = plan.build()
    assert all(part.state_dict() for part in parts)
    for one, other in zip(parts, [known.normaliser, known.actor, known.critic], strict=True):
        for (name, mine), theirs in zip(one.state_dict().items(), other.state_dict().values(), strict=True):
            assert mine.dtype == theirs.dtype, name
            assert torch.equal(mine, theirs), name


@pytest.mark.compiled
@pytest.mark.parametrize("default", [torch.bfloat16, torch.float64], indirect=True)
def test_policies_from_files_decide_as_ever(default):
    env = bsk_torch.make("NadirScan-v1", num_envs=4, seed=0)
    policy = pretrained("NadirScan-v1")
    found = env.rollout(4, policy, break_when_any_done=False)
    torch.set_default_dtype(torch.float32)
    env.set_seed(0)
    known = env.rollout(4, policy, break_when_any_done=False)
    assert torch.equal(found["action"], known["action"])
    assert torch.equal(found["next", "reward"], known["next", "reward"])


@pytest.mark.compiled
@pytest.mark.parametrize("network", ["mlp", "gru"])
@pytest.mark.parametrize("default", [torch.bfloat16, torch.float64], indirect=True)
def test_training_works_under_it(tmp_path, default, network):
    policy = train(dataclasses.replace(TINY, network=network, hidden=(8, 8)), tmp_path / "run", episodes=0)
    assert {value.dtype for value in policy.state_dict().values()} == {torch.float32, torch.float64}  # weights, statistics
    assert weights(policy).isfinite().all()


def is_fractional(node):
    return any(isinstance(part, ast.Constant) and isinstance(part.value, float) for part in ast.walk(node))


def unnamed(source):
    """Lines that make tensors of torch's default type."""
    for call in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)):
        owner = getattr(call.func, "value", None)
        if not (isinstance(owner, ast.Name) and owner.id == "torch") or any(word.arg == "dtype" for word in call.keywords):
            continue
        name = call.func.attr
        if name in FLOATING or (name in FILLED and any(map(is_fractional, call.args))):
            yield call.lineno, ast.unparse(call)
        if name == "where" and len(call.args) == 3 and all(map(is_number, call.args[1:])) and is_fractional(call):
            yield call.lineno, ast.unparse(call)


def is_number(node):
    return isinstance(node.operand if isinstance(node, ast.UnaryOp) else node, ast.Constant)


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("torch.zeros(3)", 1),
        ("torch.zeros(3, dtype=torch.float64)", 0),
        ("torch.full((3,), 0.5)", 1),
        ("torch.full((3,), 1)", 0),
        ("torch.tensor([1, 2])", 0),
        ("torch.tensor([1.0, x])", 1),
        ("torch.where(mask, 1.0, -1.0)", 1),
        ("torch.where(mask, x, -1.0)", 0),
        ("torch.where(mask, 1, 0)", 0),
        ("torch.zeros_like(x)", 0),
    ],
)
def test_the_search_finds_what_names_no_type(source, count):
    assert len(list(unnamed(source))) == count


def test_every_constructor_names_its_type():
    files = sorted(PACKAGE.rglob("*.py"))
    assert len(files) > 300
    found = [f"{file.relative_to(PACKAGE)}:{line}: {text}" for file in files for line, text in unnamed(file.read_text())]
    assert not found
