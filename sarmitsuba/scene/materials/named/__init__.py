"""Named materials, one source of figures per file."""
