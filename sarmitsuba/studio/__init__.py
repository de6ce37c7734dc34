"""The studio: a web page on this machine with sliders that simulates a scene again at every change."""
