"""Focusers: what each states against exact backprojection of the same drawn echoes, and that against a direct sum."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.support.drawn_focusing import DrawnEchoes, direct_sum, draw_echoes, draw_wide
from benchmarks.support.focuser_breaks import FORMS
from benchmarks.support.stated_row import Row
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.witness import Witness
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.metrics import image_error_db
from tests.support.unweighted import focus

BACKPROJECTIONS = (
    "backprojection,interpolation=linear",
    "backprojection,interpolation=linear,oversampling=16",
    "backprojection,interpolation=kernel:4",
    "backprojection",
    "backprojection,interpolation=kernel:8",
)
OTHERS = (
    *FORMS,
    "factorised",
    "factorised,error=-35",
    "factorised,error=-65",
    "auto,error=-50",
    "auto,error=-35",
)
# pulses times points of the direct sum: two seconds; and pixels among them that hold what a few points leave
DIRECT, BRIGHT = 6e4, 100


def focusers_outside(seed: int, names: tuple[str, ...] = OTHERS) -> Iterator[Row]:
    """The same on a recording drawn outside of what the laws were fitted on."""
    return focusers(seed, names, draw_wide(seed))


def focusers(seed: int, names: tuple[str, ...] = OTHERS, drawn: DrawnEchoes | None = None) -> Iterator[Row]:
    """All focusers, or some and backprojection, on one drawn recording: what they measured of it."""
    topic = "focusers" if drawn is None else "focusers_outside"
    drawn = drawn or draw_echoes(seed)
    raw, grid = drawn.raw, drawn.grid
    windows = {"range_window": drawn.range_window, "azimuth_window": drawn.azimuth_window}
    exact = backproject(raw, grid, **windows, interpolation="kernel:8", oversampling=4)
    case = f"{drawn.label} {drawn.range_window}/{drawn.azimuth_window}"
    for name in names:
        for row in _against(name, seed, case, drawn, exact, windows):
            yield replace(row, topic=topic)
    for row in _backprojections(seed, drawn, exact if _plain(windows) else None):
        yield replace(row, topic=topic)


def _against(
    name: str, seed: int, case: str, drawn: DrawnEchoes, exact: np.ndarray, windows: dict[str, str]
) -> Iterator[Row]:
    try:
        image = focus(drawn.raw, drawn.grid, focuser=name, **windows)
    except DataError as error:
        yield Row("focusers", name, seed, case, refused=True, note=str(error)[:80])
        return
    facts = image.metadata["focus"]
    stated = facts["stated_error_db"]
    true = image_error_db(image.data, exact)
    note = "compensated " if "motion_compensation" in facts else ""
    note += f"by {facts['method']} " if name.startswith("auto") else ""
    stated = np.nan if stated is None else stated
    yield Row("focusers", name, seed, case, stated, true, note=note + _foretold(facts))


def _foretold(facts: Mapping[str, Any]) -> str:
    """What the law said before the run; the statement is what the image measured of itself."""
    found = Witness.read(facts.get("witness"))
    return "by law alone" if found is None else f"foretold {found.law_db:.1f} dB"


def _plain(windows: dict[str, str]) -> bool:
    return set(windows.values()) == {"rectangular"}


def _backprojections(seed: int, drawn: DrawnEchoes, best: np.ndarray | None) -> Iterator[Row]:
    """Against the direct sum at the brightest pixels and at others drawn at random, which stand for all the rest."""
    raw, grid = drawn.raw, drawn.grid
    if best is None:
        best = backproject(raw, grid, interpolation="kernel:8", oversampling=4)
    power = np.abs(best[0].ravel()) ** 2
    order = np.argsort(-power)
    bright, rest = order[:BRIGHT], order[BRIGHT:]
    most = int(max(40.0, min(400.0, DIRECT / raw.radar.track.n_pulses)))
    pick = np.concatenate(
        [bright, np.random.default_rng([seed, 0xD1]).choice(rest, min(most, rest.size), False)]
    )
    weight = np.ones(pick.size)
    weight[BRIGHT:] = rest.size / (pick.size - BRIGHT)
    exact = direct_sum(raw, grid.positions().reshape(-1, 3)[pick])[0]
    for name in BACKPROJECTIONS:
        image = focus(raw, grid, focuser=name)
        error = np.sum(weight * np.abs(image.data[0].ravel()[pick] - exact) ** 2) / power.sum()
        stated = image.metadata["focus"]["stated_error_db"]
        true = 10.0 * float(np.log10(max(error, 1e-30)))
        note = _foretold(image.metadata["focus"])
        yield Row("focusers", name, seed, drawn.label, stated, true, note=note)
