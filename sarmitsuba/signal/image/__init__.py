"""Calibrated complex images, their radiometry and quality."""
