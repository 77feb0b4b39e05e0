"""The rules of the code: linter, formatter, types, floors."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]

CHECKS = {
    "ruff check": ("ruff", ["-m", "ruff", "check"]),
    "ruff format": ("ruff", ["-m", "ruff", "format", "--check", "--diff"]),
    "mypy": ("mypy", ["-m", "mypy"]),
    "import-linter": (
        "importlinter",
        # Without site, so that the finder of an editable install does not offer the tree as a
        # second place of the package.
        ["-S", "-c", "from importlinter.cli import lint_imports_command as main; main()"],
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
    places = [str(ROOT), *{sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(places), "PYTHONSAFEPATH": "1"}
    result = subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, f"{check}:\n{result.stdout}{result.stderr}"


def test_every_module_below_the_nodes_is_kept_from_ros() -> None:
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contracts = {
        contract["type"]: contract for contract in pyproject["tool"]["importlinter"]["contracts"]
    }
    floors = " ".join(contracts["layers"]["layers"])
    modules = {f"pipeline_tracker.{name}" for name in re.findall(r"\w+", floors)}
    shells = {"pipeline_tracker.cli", "pipeline_tracker.nodes"}
    assert set(contracts["forbidden"]["source_modules"]) == modules - shells
