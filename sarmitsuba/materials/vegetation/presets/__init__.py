"""One canopy a file."""
