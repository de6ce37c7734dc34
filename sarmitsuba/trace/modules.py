"""Dr.Jit and Mitsuba as untyped modules: their array types depend on the variant and defeat a type checker."""

from typing import Any

from sarmitsuba.trace.backend import ensure_backend


def modules() -> tuple[Any, Any]:
    """Start the back end and return ``(drjit, mitsuba)``."""
    ensure_backend()
    import drjit
    import mitsuba

    return drjit, mitsuba


__all__ = ["modules"]
