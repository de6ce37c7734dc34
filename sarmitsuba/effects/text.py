"""Text fragments for the reasons in the plan."""

from collections.abc import Sequence


def names(items: Sequence[str], most: int = 3) -> str:
    """List of names as text: ``a, b, c and 2 more``."""
    head = ", ".join(items[:most])
    return head + (f" and {len(items) - most} more" if len(items) > most else "")


def length(metres: float) -> str:
    """Length as text with a suitable unit."""
    if metres < 1e-3:
        return f"{1e6 * metres:.0f} um"
    return (
        f"{1e3 * metres:.3g} mm" if metres < 1.0 else f"{float(f'{metres:.3g}'):g} m"
    )  # 1140 m, not 1.14e+03
