"""Formatting, lint, annotations and static types, with the versions that the extra `test` pins."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("command", ["check", "format --check"])
def test_ruff_finds_nothing(command):
    arguments = [sys.executable, "-m", "ruff", *command.split(), "."]
    done = subprocess.run(arguments, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("folder", ["tests", "benchmarks", "docs", "notebooks"])
def test_a_name_that_is_not_defined_is_found(folder):
    arguments = [sys.executable, "-m", "ruff", "check", "--stdin-filename", f"{folder}/made_up.py", "-"]
    done = subprocess.run(arguments, cwd=ROOT, input="print(undefined)\n", capture_output=True, text=True)
    assert "Undefined name `undefined`" in done.stdout


def unannotated(source: str) -> list[str]:
    """Functions with a parameter or an answer whose type is not said; that of `__init__` goes without saying."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        given = node.args
        every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
        bare = [one.arg for one in every if one is not None and one.annotation is None]
        bare = [name for name in bare if name not in ("self", "cls", "_")]
        if bare or (node.returns is None and node.name != "__init__"):
            found.append(f"line {node.lineno}: {node.name}({', '.join(bare)})")
    return found


def test_every_function_says_its_types():
    files = sorted((ROOT / "jaxmocap").rglob("*.py"))
    assert [f"{path}, {one}" for path in files for one in unannotated(path.read_text())] == []


@pytest.mark.parametrize(
    "source",
    ["def f(x) -> int: ...", "def f(x: int): ...", "async def f(*, x) -> int: ...", "def f(*x, **y: int) -> int: ..."],
)
def test_a_type_that_is_not_said_is_found(source):
    assert len(unannotated(source)) == 1


@pytest.mark.slow
def test_pyright_finds_nothing():
    """Slow: two minutes. It comes with `pip install -e '.[dev]'`."""
    pytest.importorskip("pyright")
    arguments = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable]
    done = subprocess.run(arguments, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
