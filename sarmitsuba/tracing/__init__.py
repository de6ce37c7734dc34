"""Tracing with Dr.Jit: the kernel, scatterers by kind, derivatives."""
