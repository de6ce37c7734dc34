"""Data sets: many images of drawn scenes with their labels, from a recipe."""
