"""Named materials, one source of figures a file."""
