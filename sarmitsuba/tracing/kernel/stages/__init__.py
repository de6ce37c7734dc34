"""Stages of the built-in effects, one module each; see :mod:`sarmitsuba.tracing.kernel.stage`."""
