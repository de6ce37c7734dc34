"""Benchmarks of ``make benchmarks``, one a module; ``run_all`` runs them."""
