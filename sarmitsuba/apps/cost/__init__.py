"""Cost studies of error against run time: sweeps, model and report."""
