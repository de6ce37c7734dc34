"""Fixtures of all tests."""

import matplotlib

from sarmitsuba.backend import prepare_llvm

matplotlib.use("Agg")

# Dr.Jit reads the path of LLVM when it is first imported, which a test may do before any library code runs
prepare_llvm()
