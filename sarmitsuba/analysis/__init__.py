"""Image analysis: quality, polarimetry and interferometry."""
