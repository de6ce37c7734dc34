"""Studies, run by hand."""
