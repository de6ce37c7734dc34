"""Every kind of planted error is caught by at least one validation case."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "studies" / "planted_errors.py"


@pytest.mark.slow
def test_every_planted_error_is_caught() -> None:
    done = subprocess.run([sys.executable, str(SCRIPT)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert "**nothing**" not in done.stdout and done.stdout.count("|") > 40
