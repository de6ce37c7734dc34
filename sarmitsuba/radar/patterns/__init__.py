"""Antenna patterns, one per file; see :mod:`sarmitsuba.radar.pattern`."""
