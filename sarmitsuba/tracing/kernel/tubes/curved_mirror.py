"""Variation of the surface normal over a ray tube on a curved mirror, which makes the tube diverge or converge."""

from __future__ import annotations

from collections.abc import Callable

from sarmitsuba.machine.backend import dr, mi

# largest cross-section of a tube behind curved mirrors relative to flat ones; the ray ends beyond it: its field is
# 120 dB down, and further mirrors would leave the range of float32
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
