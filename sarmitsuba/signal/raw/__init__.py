"""Raw-data formation: gridding of echoes, pulses from grids, waveform and receiver noise; NumPy only."""
