"""Tests; ``tests.support`` is shared with the benchmarks."""
