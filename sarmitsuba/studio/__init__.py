"""The bench: a scene under sliders, simulated anew at every change, on a page of this machine."""
