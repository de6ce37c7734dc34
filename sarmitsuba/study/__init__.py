"""Theory, radar cross sections, validation and cost."""
