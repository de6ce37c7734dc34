"""Planning of a run before it is traced: pilot, sampling, sources, forecast."""
