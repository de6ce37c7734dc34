"""Constants, units, errors, parameters, registries, progress and timing: what every room may use."""
