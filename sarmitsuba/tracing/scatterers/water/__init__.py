"""Water: waves under wind, and change with time."""
