"""Mitsuba plugins of the radar, one per file; loaded as ``sarmitsuba_plugins`` by `sarmitsuba.register_plugins`."""
