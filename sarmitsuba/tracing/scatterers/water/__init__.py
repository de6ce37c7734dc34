"""Water under wind: its waves and their motion."""
