"""Echo stage: spreading onto grids, pulses from grids, waveform and receiver noise; NumPy only."""
