"""The table of hard cases: what every test of this folder measures, docs/numerics.md shows."""

from collections.abc import Callable

import numpy as np
import pytest


@pytest.fixture
def row(record_property: Callable[[str, object], None]) -> Callable[..., None]:
    """Check one line of the table: our error within the bound, the naive way's beyond it.

    Arguments: case, our error, its bound, unit; ``naive`` the error of the naive way where the test measures it,
    and ``remedy``, what is done in its place. ``benchmarks/numerics.py`` collects the lines.
    """

    def check(
        case: str,
        ours: float,
        bound: float,
        unit: str = "",
        *,
        naive: float | None = None,
        remedy: str = "",
    ) -> None:
        line = {"case": case, "ours": float(ours), "bound": float(bound), "unit": unit, "remedy": remedy}
        if naive is not None:
            line["naive"] = float(naive)
        record_property("numerics", line)
        print(f"\n{case}: naive {naive}, ours {ours:.3g}, bound {bound:g} {unit}")
        assert ours <= bound, f"{case}: {ours:g} {unit} is above {bound:g}"
        if naive is not None:
            assert not np.isfinite(naive) or naive > bound, (
                f"{case}: the naive way would do: {naive:g} {unit}"
            )

    return check
