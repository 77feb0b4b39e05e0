"""The rules of the code: linter, formatter, types, floors."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]

CHECKS = {
    "ruff check": ("ruff", ["-m", "ruff", "check"]),
    "ruff format": ("ruff", ["-m", "ruff", "format", "--check", "--diff"]),
    "mypy": ("mypy", ["-m", "mypy"]),
    "import-linter": (
        "importlinter",
        ["-c", "from importlinter.cli import lint_imports_command as main; main()"],
    ),
}


@pytest.mark.parametrize("check", CHECKS)
def test_the_code_keeps_the_rules(check: str) -> None:
    module, arguments = CHECKS[check]
    if find_spec(module) is None:
        pytest.skip(f"{module} is not installed; the extra [test] has it")
    if module == "mypy" and np.lib.NumpyVersion(np.__version__) < "2.4.0":
        pytest.skip(f"types are checked by those of NumPy 2.4 or newer, here is {np.__version__}")
    # import-linter looks for the package where Python does; it must be this tree's.
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    result = subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, f"{check}:\n{result.stdout}{result.stderr}"
