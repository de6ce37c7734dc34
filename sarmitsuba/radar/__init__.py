"""The sensor: its description, track, waveform, antenna, receive window, requested image and link budget."""
