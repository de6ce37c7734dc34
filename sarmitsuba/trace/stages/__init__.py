"""Stages of the built-in effects, one module each; see :mod:`sarmitsuba.trace.stage`."""
