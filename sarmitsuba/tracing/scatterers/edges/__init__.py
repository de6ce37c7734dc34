"""Edges of metal: diffraction, rims, wedges."""
