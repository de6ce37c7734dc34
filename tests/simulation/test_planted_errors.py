"""Every kind of planted error is caught by at least one validation case."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_every_planted_error_is_caught() -> None:
    command = [sys.executable, "-m", "benchmarks.studies.planted_errors"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert "**nothing**" not in done.stdout and done.stdout.count("|") > 40
