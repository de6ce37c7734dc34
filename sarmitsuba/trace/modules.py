"""Dr.Jit and Mitsuba as untyped modules: their array types depend on the variant and defeat a type checker."""

import sys
from functools import lru_cache
from typing import Any

from sarmitsuba.backend import ensure_backend


def modules() -> tuple[Any, Any]:
    """Start the back end and return ``(drjit, mitsuba)``; called wherever a kernel is recorded, so it is quick."""
    mitsuba = sys.modules.get("mitsuba")
    variant = mitsuba.variant() if mitsuba is not None else None
    if variant is None:
        ensure_backend()
    else:
        _checked(variant)
    import drjit
    import mitsuba

    return drjit, mitsuba


@lru_cache(maxsize=8)
def _checked(variant: str) -> None:
    """Check once that a variant set by others can trace."""
    ensure_backend()


__all__ = ["modules"]
