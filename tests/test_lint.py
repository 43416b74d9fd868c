"""Formatting, lint and static types, with the versions that the extra `test` pins."""

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


@pytest.mark.slow
def test_pyright_finds_nothing():
    """Slow: two minutes. It comes with `pip install -e '.[dev]'`."""
    pytest.importorskip("pyright")
    arguments = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable]
    done = subprocess.run(arguments, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
