"""Calibrated complex images, their radiometry and their quality."""
