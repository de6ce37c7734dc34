"""What tests and benchmarks share: drawn radars, cities of boxes, single paths of the kernel."""
