"""Benchmarks: each measures, prints tables and claims, and writes JSON; run from the checkout with ``python -m``."""
