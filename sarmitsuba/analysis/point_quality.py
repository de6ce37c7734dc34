"""Point targets in an image, found or given: positions, impulse responses and their predicted widths."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from sarmitsuba.analysis.carrier import Carrier, Lobes
from sarmitsuba.core.arrays import C64, C128
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.radar.polarisation import isotropic_response
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import Chip, CutMetrics, PointTargetMetrics, point_target

_NODES, _FINE = 1024, 64


@cache
def window_irw(text: str) -> float:
    """Half-power width of the impulse response of a window, cells of the unweighted band (rectangular: 0.886)."""
    window = parse_window(text).aperture(_NODES)
    response = np.abs(np.fft.rfft(window, _NODES * _FINE)[: 4 * _FINE]) ** 2
    i = int(np.flatnonzero(response < 0.5 * response[0])[0])
    part = (response[i - 1] - 0.5 * response[0]) / (response[i - 1] - response[i])
    return float(2.0 * (i - 1 + part) / _FINE)


def windows_of(image: SarImage) -> tuple[Window, Window]:
    """Azimuth and range window of the image; rectangular if not recorded."""
    facts = image.metadata.get("focus", {})
    azimuth, range_ = (
        parse_window(str(facts.get(name, "rectangular"))) for name in ("azimuth_window", "range_window")
    )
    return azimuth, range_


def grid_cells(image: SarImage, column: int) -> tuple[float, float]:
    """Noise-equivalent cells in azimuth and range at a column, in metres of the grid."""
    grid = image.grid
    azimuth, range_ = image.azimuth_resolution_cell, image.range_resolution_cell
    fit = image.metadata.get("focus", {}).get("azimuth_cell_polynomial")
    if fit is not None:
        x = (grid.range[column] - fit["center"]) / fit["scale"]
        azimuth *= float(np.polynomial.polynomial.polyval(x, np.asarray(fit["coefficients"])))
    if grid.kind == "ground":
        range_ /= float(np.sin(image.incidence_angle[column]))
    return azimuth, range_


def predicted_irw(image: SarImage, lobes: Lobes, column: int) -> tuple[float, float]:
    r"""Predicted half-power widths along the azimuth and the range lobe, from cells and windows, m of the grid.

    For a spectrum of the form of a parallelogram: the range cell over the gradient of the slant range and the skew, and
    the area of the impulse response over the range cell,

    .. math:: w_r = \frac{\delta_r}{|\nabla D| s}, \qquad w_a = \frac{A |\nabla D|}{\delta_r}
    """
    azimuth, _ = grid_cells(image, column)
    area = azimuth * image.range_resolution_cell / float(np.sin(image.incidence_angle[column]))
    grid = image.grid
    if grid.kind == "slant":  # range columns are denser than ground metres
        area *= float(grid.across_distance()[column] / grid.range[column])
    radial = image.range_resolution_cell / lobes.slope
    widths = [window_irw(str(window)) / window.broadening for window in windows_of(image)]
    return widths[0] * area / radial, widths[1] * radial / lobes.skew


# half size of a chip, cells: ISLR to 10 widths fits for every window
_REACH = 16.0
_SMALLEST_CHIP, _LARGEST_CHIP = 32, 512
# Search: brightest within a number of cells, a level above its surroundings (the maximum of 4000 pixels of speckle is
# 9.2 dB above the mean), and about the width of a point
_ALONE, _ABOVE_DB = 6.0, 16.0
_WIDTHS = (0.7, 1.4)
# side lobes of a point: -13 dB without window, and 5 dB for clutter 16 dB below the peak. Higher ones are other targets
# or speckle
_HIGHEST_LOBE_DB = -8.0
# mean over median of single-look intensity
_MEAN_OVER_MEDIAN = 1.0 / math.log(2.0)


@dataclass(frozen=True)
class KnownPoint:
    """Point target at a known position.

    Parameters
    ----------
    position : x, y, z in m, frame of the scene's file
    name : for tables
    rcs : m^2, where known
    phase : rad, of its reflectivity, where known
    """

    position: tuple[float, float, float]
    name: str = ""
    rcs: float | None = None
    phase: float | None = None


@dataclass(frozen=True)
class PointQuality:
    """Measured quality of a point target; NaN where no reference is known.

    Parameters
    ----------
    name : of the point
    azimuth, range : m, peak in the grid's coordinates
    position : m, x, y, z of the peak on the image plane, frame of the scene's file
    azimuth_error, range_error : m, peak minus expected position in the image
    rcs : m^2, |peak|^2
    rcs_error_db : relative to the known RCS
    phase : rad, at the known position, else at the peak
    phase_error : rad, relative to the known phase, at the known position
    background_db : peak over the mean of the surroundings
    azimuth_cut, range_cut : impulse response along the lobes, see :class:`sarmitsuba.signal.metrics.CutMetrics`
    predicted_irw : m, of azimuth and range, from cells and windows
    """

    name: str
    azimuth: float
    range: float
    position: tuple[float, float, float]
    azimuth_error: float
    range_error: float
    rcs: float
    rcs_error_db: float
    phase: float
    phase_error: float
    background_db: float
    azimuth_cut: CutMetrics
    range_cut: CutMetrics
    predicted_irw: tuple[float, float]


def scene_points(image: SarImage, channel: str | None = None) -> tuple[KnownPoint, ...]:
    """Point scatterers of the scene at rest, from the image's metadata, with their reflectivity in a channel."""
    entries = image.metadata.get("points", ())
    if not entries:
        return ()  # images from elsewhere may have channels of any name
    response = isotropic_response(channel or image.channels[0])
    return tuple(
        KnownPoint(
            (float(entry["position"][0]), float(entry["position"][1]), float(entry["position"][2])),
            str(entry["name"]),
            float(entry["rcs"]) * abs(response) ** 2 if response else None,
            float(entry["phase"]) + float(np.angle(response)) if response else None,
        )
        for entry in entries
        if isinstance(entry, Mapping) and not _moves(entry)
    )


def _moves(entry: Mapping[str, object]) -> bool:
    """Whether a point of the metadata moves, so that the image shows it displaced."""
    motion = [entry.get(name) for name in ("velocity", "acceleration")]
    return any(isinstance(numbers, list) and any(numbers) for numbers in motion)


def measure_known(
    image: SarImage, points: Sequence[KnownPoint], channel: str | None = None
) -> tuple[tuple[PointQuality, ...], tuple[str, ...]]:
    """Measure points at known positions; returns one line for each point that cannot be measured.

    Returns
    -------
    measured points, and one line for each other point
    """
    carrier, data = Carrier.of(image), image.total(channel)
    found, left_out = [], []
    for i, point in enumerate(points):
        name = point.name or f"point {i + 1}"
        try:
            place = carrier.place(np.asarray(point.position, dtype=np.float64) - image.grid.offset)
            found.append(_measure(image, data, carrier, place, name, point))
        except DataError as error:
            left_out.append(f"{name}: {error}")
    return tuple(found), tuple(left_out)


def find_points(image: SarImage, channel: str | None = None, most: int = 12) -> tuple[PointQuality, ...]:
    """Find isolated point targets, the brightest first.

    A point is a pixel that is the brightest within 6 cells, 16 dB above the mean of its surroundings, of about the
    predicted width (0.7 to 1.4 times, in both directions), without a side lobe above -8 dB, and not at the image's
    edge.
    """
    carrier, data = Carrier.of(image), image.total(channel)
    power = np.abs(data.astype(np.complex128)) ** 2
    cells = grid_cells(image, image.grid.range.size // 2)
    spacing = (image.grid.azimuth_spacing, image.grid.range_spacing)
    size = [2 * math.ceil(_ALONE * cell / step) + 1 for cell, step in zip(cells, spacing, strict=True)]
    top = scipy.ndimage.maximum_filter(power, size=size, mode="nearest")
    lit = power[power > 0.0]
    if not lit.size:
        return ()
    level = float(np.median(lit)) * _MEAN_OVER_MEDIAN
    rows, columns = np.nonzero((power == top) & (power > level * power_from_db(_ABOVE_DB)))
    order = np.argsort(-power[rows, columns], kind="stable")
    found: list[PointQuality] = []
    for row, column in zip(rows[order], columns[order], strict=True):
        if len(found) == most:
            break
        place = float(image.grid.azimuth[row]), float(image.grid.range[column])
        try:
            point = _measure(image, data, carrier, place, f"found {len(found) + 1}", None)
        except DataError:
            continue  # at the edge, or no separate peak
        ratios = [
            cut.irw / wanted
            for cut, wanted in zip((point.azimuth_cut, point.range_cut), point.predicted_irw, strict=True)
        ]
        alone = all(cut.pslr_db < _HIGHEST_LOBE_DB for cut in (point.azimuth_cut, point.range_cut))
        narrow = all(_WIDTHS[0] < ratio < _WIDTHS[1] for ratio in ratios)
        if point.background_db >= _ABOVE_DB and narrow and alone:
            found.append(point)
    return tuple(found)


def _measure(
    image: SarImage,
    data: C64,
    carrier: Carrier,
    place: tuple[float, float],
    name: str,
    known: KnownPoint | None,
) -> PointQuality:
    """Measure the point near grid coordinates."""
    grid = image.grid
    start, step = (
        (float(grid.azimuth[0]), float(grid.range[0])),
        (grid.azimuth_spacing, grid.range_spacing),
    )
    pixel = [(p - s) / d for p, s, d in zip(place, start, step, strict=True)]
    if not all(-0.5 <= p <= n - 0.5 for p, n in zip(pixel, grid.shape, strict=True)):
        raise DataError(f"azimuth {place[0]:.6g} m, range {place[1]:.6g} m is outside the image")
    column = int(np.clip(round(pixel[1]), 0, grid.shape[1] - 1))
    cells = grid_cells(image, column)
    piece = _square(pixel, cells, step, grid.shape)
    first = (piece[0].start, piece[1].start)
    chip = carrier.remove_carrier(data, *piece)
    lobes = carrier.lobes(*place)
    m = point_target(
        chip,
        step[0],
        step[1],
        near=(pixel[0] - first[0], pixel[1] - first[1]),
        chip=max(chip.shape),
        azimuth_direction=lobes.azimuth,
        range_direction=lobes.range,
    )
    azimuth = float(start[0] + first[0] * step[0] + m.azimuth_position)
    range_ = float(start[1] + first[1] * step[1] + m.range_position)
    x, y, z = carrier.scene_position(azimuth, range_).tolist()
    turn = float(np.angle(carrier.phasor(*place if known else (azimuth, range_))))
    phase = m.phase
    if known is not None:
        at = [p - f for p, f in zip(pixel, first, strict=True)]
        phase = float(np.angle(Chip(chip).at([at[0]], [at[1]])[0]))
    phase = _wrap_phase(phase + turn)
    return PointQuality(
        name=name,
        azimuth=azimuth,
        range=range_,
        position=(x, y, z),
        azimuth_error=azimuth - place[0] if known else math.nan,
        range_error=range_ - place[1] if known else math.nan,
        rcs=m.rcs,
        rcs_error_db=db_from_power(m.rcs / known.rcs) if known and known.rcs else math.nan,
        phase=phase,
        phase_error=_wrap_phase(phase - known.phase) if known and known.phase is not None else math.nan,
        background_db=_background_db(chip, m, cells, step),
        azimuth_cut=m.azimuth,
        range_cut=m.range,
        predicted_irw=predicted_irw(image, lobes, column),
    )


def _square(
    pixel: Sequence[float], cells: tuple[float, float], step: tuple[float, float], shape: tuple[int, int]
) -> tuple[slice, slice]:
    """Part of the image about a point."""
    half = [
        int(np.clip(math.ceil(_REACH * cell / d), _SMALLEST_CHIP // 2, _LARGEST_CHIP // 2))
        for cell, d in zip(cells, step, strict=True)
    ]
    rows, columns = (
        slice(max(round(p) - h, 0), min(round(p) + h + 1, n))
        for p, h, n in zip(pixel, half, shape, strict=True)
    )
    return rows, columns


def _background_db(
    chip: C128, m: PointTargetMetrics, cells: tuple[float, float], step: tuple[float, float]
) -> float:
    """Peak over the mean of the surroundings without the point's lobes, from their median."""
    away = [
        np.abs(np.arange(n) - index) * d > 3.0 * cell
        for n, index, d, cell in zip(chip.shape, (m.azimuth_index, m.range_index), step, cells, strict=True)
    ]
    rest = np.abs(chip[np.ix_(*away)]) ** 2
    level = float(np.median(rest)) * _MEAN_OVER_MEDIAN if rest.size else 0.0
    return db_from_power(m.rcs / level) if level > 0.0 else math.inf


def _wrap_phase(phase: float) -> float:
    return math.remainder(phase, 2.0 * math.pi)
