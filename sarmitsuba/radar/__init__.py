"""The sensor: track, waveform, antenna, receive window and link budget."""
