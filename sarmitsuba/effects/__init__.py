"""Which physical effects a scene needs."""
