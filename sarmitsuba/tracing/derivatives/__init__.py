"""Derivatives of echoes by parameters of a scene: tangents and adjoints beside the kernel."""
