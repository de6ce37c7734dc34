"""Constants, units, errors, parameters, registries, progress and timing, for every room."""
