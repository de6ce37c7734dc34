"""What a run does before it is traced: pilot, sampling, sources, forecast."""
