"""Tests run and can fail: folders are packages, and no test makes all its checks in loops that may have nothing to run over."""

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent

CHECKS = {"raises", "warns", "fail", "check_env_specs", "check_env", "check_output", "check_call", "check_refusals"}
"""Functions that fail a test, besides those whose names begin with ``assert_``."""

TRANSPARENT = {"enumerate", "zip", "product", "sorted", "reversed", "range", "len", "list", "items", "values", "keys"}
"""Functions and methods that are not empty where their arguments, or their objects, are not."""


SCOPES = (ast.FunctionDef, ast.Lambda, ast.ClassDef)


def called(node: ast.Call) -> str:
    """Name of the function or method."""
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def is_check(node: ast.AST) -> bool:
    """Whether a statement or call can fail a test."""
    if isinstance(node, ast.Call):
        return called(node) in CHECKS or called(node).startswith("assert_")
    return isinstance(node, ast.Assert)


def arguments(node: ast.Call) -> list[ast.expr]:
    """Arguments of a call, without stars; the object of a method without arguments."""
    given = [arg.value if isinstance(arg, ast.Starred) else arg for arg in node.args]
    return [node.func.value] if isinstance(node.func, ast.Attribute) and not given else given


def never_empty(node: ast.expr, known: dict[str, ast.expr]) -> bool:
    """Whether an iterable certainly has items, or a number is not zero, where variables are what ``known`` says."""
    match node:
        case ast.Tuple(elts=items) | ast.List(elts=items) | ast.Set(elts=items):
            return any(not isinstance(item, ast.Starred) or never_empty(item.value, known) for item in items)
        case ast.Dict(keys=keys, values=values):
            return any(key is not None or never_empty(value, known) for key, value in zip(keys, values, strict=True))
        case ast.ListComp(generators=loops) | ast.SetComp(generators=loops) | ast.DictComp(generators=loops):
            return all(not loop.ifs and never_empty(loop.iter, known) for loop in loops)
        case ast.Constant(value=value):
            return bool(value)
        case ast.IfExp(body=first, orelse=second):
            return never_empty(first, known) and never_empty(second, known)
        case ast.Name(id=name) if name in known:
            return never_empty(known[name], {other: value for other, value in known.items() if other != name})
        case ast.Call() if called(node) == "zip" and any(word.arg == "strict" and word.value.value for word in node.keywords):
            return any(never_empty(item, known) for item in arguments(node))
        case ast.Call() if called(node) in TRANSPARENT:
            return bool(arguments(node)) and all(never_empty(item, known) for item in arguments(node))
    return False


def certain_checks(nodes: Iterable[ast.AST], known: dict[str, ast.expr]) -> Iterator[ast.AST]:
    """Checks that do not stand in a loop that may be empty."""
    for node in nodes:
        if isinstance(node, ast.For) and never_empty(node.iter, known):
            yield from certain_checks(node.body, known)
        if isinstance(node, (ast.For, ast.While, ast.comprehension, *SCOPES)):
            continue
        if is_check(node):
            yield node
        yield from certain_checks(ast.iter_child_nodes(node), known)


def own_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Nodes of a module or function that are not part of a function or class inside it."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, SCOPES):
            yield child
            yield from own_nodes(child)


def assigned(node: ast.Module | ast.FunctionDef) -> dict[str, ast.expr]:
    """Expressions of the names that a module or function assigns once."""
    found: dict[str, list[ast.expr]] = {}
    for child in own_nodes(node):
        targets = child.targets if isinstance(child, ast.Assign) else [child.target] if isinstance(child, ast.AnnAssign) else []
        for target in targets:
            if isinstance(target, ast.Name) and child.value is not None:
                found.setdefault(target.id, []).append(child.value)
    return {name: values[0] for name, values in found.items() if len(values) == 1}


def idle(path: Path) -> list[str]:
    """Tests and ``assert_...`` helpers of a file that have checks, all of them in loops that may be empty."""
    tree = ast.parse(path.read_text())
    constants = assigned(tree)
    return [
        f"{path.relative_to(TESTS)}:{function.lineno} {function.name}"
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        and function.name.startswith(("test", "assert_"))
        and any(is_check(node) for node in own_nodes(function))
        and not any(certain_checks(function.body, constants | assigned(function)))
    ]


def test_folders_of_tests_are_packages():
    """Without ``__init__.py``, pytest takes a file for another one of the same name in another folder and does not run it."""
    folders = {path.parent for path in TESTS.rglob("test_*.py")}
    assert TESTS in folders
    assert not [str(folder.relative_to(TESTS)) for folder in sorted(folders) if not (folder / "__init__.py").exists()]


def test_checks_run():
    files = sorted(TESTS.rglob("*.py"))
    assert Path(__file__) in files
    found = [place for path in files for place in idle(path)]
    assert not found, "these check only in loops that may be empty; assert that there is something: " + ", ".join(found)


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("for x in found():\n    assert x", True),
        ("for x in (1, 2):\n    assert x", False),
        ("for k, x in enumerate(NAMES):\n    assert x", False),
        ("for k in range(len(found())):\n    assert k", True),
        ("xs = found()\n  assert xs\n  for x in xs:\n    assert x", False),
        ("with pytest.raises(ValueError):\n    found()", False),
        ("for x in found():\n    for y in (1, 2):\n      assert_close(x, y)", True),
        ("for x, y in zip(found(), (1, 2), strict=True):\n    assert x == y", False),
        ("for x, y in zip(found(), (1, 2), strict=False):\n    assert x == y", True),
        ("xs = [x for x in (1, 2)]\n  for x in xs:\n    assert x", False),
        ("xs = [x for x in (1, 2) if found()]\n  for x in xs:\n    assert x", True),
        ("for k in range(3):\n    assert k", False),
        ("found()", False),
    ],
)
def test_idle_checks_are_found(body, expected, tmp_path, monkeypatch):
    monkeypatch.setattr(f"{__name__}.TESTS", tmp_path)
    (tmp_path / "test_x.py").write_text(f"NAMES = ('a',)\ndef test_x():\n  {body}\n")
    assert bool(idle(tmp_path / "test_x.py")) is expected
