"""The studio: a local web page with sliders that simulates a scene again at every change."""
