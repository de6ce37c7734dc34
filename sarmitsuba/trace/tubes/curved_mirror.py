"""How a curved mirror turns the normal over a ray tube, so that tubes spread as its smooth surface would."""

from __future__ import annotations

from collections.abc import Callable

from sarmitsuba.backend import dr, mi

# cross-section of a tube behind curved mirrors over that behind flat ones, beyond which its ray ends: its field is then
# 120 dB down, and float32 soon no longer holds what further mirrors make of it
WIDEST_SPREAD = 1e12


def normal_change(
    table: mi.Float, face: mi.UInt32, active: mi.Bool, sign: mi.Float
) -> Callable[[mi.Vector3f], mi.Vector3f]:
    """Change of the normal for a step on the facet: a function of float32 vectors; ``sign`` -1 reverses the normal."""
    a = dr.gather(mi.Vector4f, table, face * 2, active)
    b = dr.gather(mi.Vector4f, table, face * 2 + 1, active)

    def apply(step: mi.Vector3f) -> mi.Vector3f:
        return (
            mi.Vector3f(
                a.x * step.x + a.w * step.y + b.x * step.z,
                a.w * step.x + a.y * step.y + b.y * step.z,
                b.x * step.x + b.y * step.y + a.z * step.z,
            )
            * sign
        )

    return apply


__all__ = ["WIDEST_SPREAD", "normal_change"]
