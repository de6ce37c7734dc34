"""Built-in effects, one module each, registered in ``EFFECTS``."""
