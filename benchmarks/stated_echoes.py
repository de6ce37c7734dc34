"""Focusers: what each states against exact backprojection of the same drawn echoes, and that against a direct sum."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from drawn_focusing import DrawnEchoes, direct_sum, draw_echoes
from focuser_breaks import FORMS
from stated_row import Row

from sarmitsuba.errors import DataError
from sarmitsuba.focusing import focus
from sarmitsuba.focusing.focusers.backprojection import backproject
from sarmitsuba.image.metrics import image_error_db

BACKPROJECTIONS = (
    "backprojection,interpolation=linear",
    "backprojection,interpolation=linear,oversampling=16",
    "backprojection,interpolation=kernel:4",
    "backprojection",
    "backprojection,interpolation=kernel:8",
)
OTHERS = (*FORMS, "factorised", "factorised,error=-35", "factorised,error=-65", "auto", "auto,error=-35")
# pulses times points of the direct sum: two seconds
DIRECT = 6e4


def focusers(seed: int, names: tuple[str, ...] = OTHERS) -> Iterator[Row]:
    """All focusers, or some and backprojection, on one drawn recording."""
    drawn = draw_echoes(seed)
    raw, grid = drawn.raw, drawn.grid
    windows = {"range_window": drawn.range_window, "azimuth_window": drawn.azimuth_window}
    exact = backproject(raw, grid, **windows, interpolation="kernel:8", oversampling=4)
    case = f"{drawn.label} {drawn.range_window}/{drawn.azimuth_window}"
    for name in names:
        yield _against(name, seed, case, drawn, exact, windows)
    yield from _backprojections(seed, drawn)


def _against(
    name: str, seed: int, case: str, drawn: DrawnEchoes, exact: np.ndarray, windows: dict[str, str]
) -> Row:
    try:
        image = focus(drawn.raw, drawn.grid, focuser=name, **windows)
    except DataError as error:
        return Row("focusers", name, seed, case, refused=True, note=str(error)[:80])
    facts = image.metadata["focus"]
    stated = facts["stated_error_db"]
    true = image_error_db(image.data, exact)
    note = "compensated" if "motion_compensation" in facts else ""
    note += f" by {facts['method']}" if name.startswith("auto") else ""
    return Row("focusers", name, seed, case, np.nan if stated is None else stated, true, note=note)


def _backprojections(seed: int, drawn: DrawnEchoes) -> Iterator[Row]:
    """Against the direct sum, at pixels evenly over the image."""
    raw, grid = drawn.raw, drawn.grid
    points = max(40.0, min(400.0, DIRECT / raw.radar.track.n_pulses))
    step = max(1, int(np.sqrt(np.prod(grid.shape) / points)))
    some = replace(grid, azimuth=grid.azimuth[step // 2 :: step], range=grid.range[step // 2 :: step])
    exact = direct_sum(raw, some.positions().reshape(-1, 3))
    for name in BACKPROJECTIONS:
        image = focus(raw, grid, focuser=name)
        taken = image.data[:, step // 2 :: step, step // 2 :: step].reshape(exact.shape)
        stated = image.metadata["focus"]["stated_error_db"]
        yield Row("focusers", name, seed, drawn.label, stated, image_error_db(taken, exact))
