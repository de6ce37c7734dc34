"""Pictures of images (matplotlib, no display needed)."""
