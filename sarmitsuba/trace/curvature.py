"""How a curved mirror turns the normal over a ray tube, so that tubes spread as its smooth surface would."""

from typing import Any


def turned(table: Any, face: Any, active: Any, side: Any, dr: Any, mi: Any) -> Any:
    """Change of the normal for a step on the facet: a function of float32 vectors; ``side`` -1 turns the normal."""
    a = dr.gather(mi.Vector4f, table, face * 2, active)
    b = dr.gather(mi.Vector4f, table, face * 2 + 1, active)

    def apply(step: Any) -> Any:
        return (
            mi.Vector3f(
                a.x * step.x + a.w * step.y + b.x * step.z,
                a.w * step.x + a.y * step.y + b.y * step.z,
                b.x * step.x + b.y * step.y + a.z * step.z,
            )
            * side
        )

    return apply


__all__ = ["turned"]
