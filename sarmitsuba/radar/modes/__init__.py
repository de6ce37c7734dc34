"""Radar modes, one per file; see :mod:`sarmitsuba.radar.mode`."""
