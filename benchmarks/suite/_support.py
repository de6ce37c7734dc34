"""Search path of the scripts of this folder: what they share is in ``benchmarks/support``."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
