"""Image quality: point responses, statistics of areas, noise level, and spectral looks.

Areas are measured by speckle, contrast and entropy. Spectral looks are the mean power of sub-apertures and sub-bands.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from sarmitsuba.analysis.carrier import Carrier
from sarmitsuba.analysis.point_quality import (
    KnownPoint,
    PointQuality,
    find_points,
    grid_cells,
    measure_known,
    scene_points,
    windows_of,
)
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import EMPTY_DB
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image import ImageGrid, SarImage, block_means
from sarmitsuba.signal.metrics import equivalent_number_of_looks, windows_over

# cells along the edge of an automatic area, and of the pieces by which it is chosen
_EDGE, _PIECE = 24.0, 6.0
# share of the noise's power below which an echo is not seen; pixels along a block
_NOISE_SHARE, _BLOCK = 0.1, 16


@dataclass(frozen=True)
class Area:
    """Rectangle in the image's coordinates.

    Parameters
    ----------
    azimuth, range : first and last, m of the grid
    name : for tables
    """

    azimuth: tuple[float, float]
    range: tuple[float, float]
    name: str = ""

    def pixels(self, grid: ImageGrid) -> tuple[slice, slice]:
        """Rows and columns of the pixels inside.

        Raises
        ------
        DataError
            There are fewer than 2 x 2 pixels.
        """
        found = []
        for axis, (first, last) in ((grid.azimuth, self.azimuth), (grid.range, self.range)):
            low, high = np.searchsorted(axis, (first, last), side="left")
            found.append(slice(int(low), int(high) + int(high < axis.size and axis[high] == last)))
        if min(part.stop - part.start for part in found) < 2:
            raise DataError(
                f"area {self.name or ''} azimuth {self.azimuth[0]:g} ... {self.azimuth[1]:g} m, range "
                f"{self.range[0]:g} ... {self.range[1]:g} m: holds fewer than 2 x 2 pixels of the image, which spans "
                f"{grid.azimuth[0]:g} ... {grid.azimuth[-1]:g} m and {grid.range[0]:g} ... {grid.range[-1]:g} m"
            )
        return found[0], found[1]


@dataclass(frozen=True)
class AreaQuality:
    r"""Measured quality of an area.

    Parameters
    ----------
    name : of the area
    azimuth, range : first and last, m of the grid
    pixels : their number
    cells : resolution cells in it
    sigma0_db : of the mean
    enl : :math:`\langle I \rangle^2 / \mathrm{var} I`; 1 for fully developed speckle of one look
    enl_sigma : standard deviation of that estimate, :math:`\mathrm{ENL} \sqrt{2 (1 + 1 / \mathrm{ENL}) / n}`, n cells,
        for gamma-distributed intensity
    predicted_enl : of the averaged looks, 1 without
    contrast : standard deviation over mean of the intensity
    entropy : :math:`-\sum p \ln p`, :math:`p = I / \sum I`
    entropy_deficit : :math:`\ln N - \mathrm{entropy}`; 0 for equal pixels, 0.423 for single-look speckle
    """

    name: str
    azimuth: tuple[float, float]
    range: tuple[float, float]
    pixels: int
    cells: float
    sigma0_db: float
    enl: float
    enl_sigma: float
    predicted_enl: float
    contrast: float
    entropy: float
    entropy_deficit: float


def contrast(intensity: NDArray[np.floating]) -> float:
    """Contrast: standard deviation over mean of the intensity."""
    values = np.asarray(intensity, dtype=np.float64)
    mean = float(values.mean())
    return float(values.std()) / mean if mean > 0.0 else 0.0


def entropy(intensity: NDArray[np.floating]) -> float:
    """Entropy of the intensity as a distribution, nats."""
    values = np.asarray(intensity, dtype=np.float64).ravel()
    total = float(values.sum())
    if not total > 0.0:
        return 0.0
    p = values[values > 0.0] / total
    return float(-np.sum(p * np.log(p)))


def measure_area(
    image: SarImage, area: Area, sigma0: F64, predicted_enl: float = 1.0, cells: float = 1.0
) -> AreaQuality:
    """Measure an area.

    Parameters
    ----------
    image : of the area
    area : the rectangle
    sigma0 : (n_azimuth, n_range) float64, of the image or of its looks
    predicted_enl : of the looks in ``sigma0``
    cells : ratio of the cell areas of ``sigma0`` and of the image
    """
    grid = image.grid
    rows, columns = area.pixels(grid)
    part = sigma0[rows, columns]
    cell = grid_cells(image, (columns.start + columns.stop) // 2)
    size = part.size * grid.azimuth_spacing * grid.range_spacing
    count = max(size / (cell[0] * cell[1] * cells), 1.0)
    looks = equivalent_number_of_looks(part)
    mean, spread = float(part.mean()), entropy(part)
    return AreaQuality(
        name=area.name,
        azimuth=(float(grid.azimuth[rows.start]), float(grid.azimuth[rows.stop - 1])),
        range=(float(grid.range[columns.start]), float(grid.range[columns.stop - 1])),
        pixels=part.size,
        cells=count,
        sigma0_db=db_from_power(mean),
        enl=looks,
        enl_sigma=looks * math.sqrt(2.0 * (1.0 + 1.0 / looks) / count) if looks > 0.0 else math.nan,
        predicted_enl=predicted_enl,
        contrast=contrast(part),
        entropy=spread,
        entropy_deficit=math.log(part.size) - spread,
    )


def automatic_areas(
    image: SarImage, channel: str | None = None, points: Sequence[tuple[float, float]] = ()
) -> tuple[Area, ...]:
    """Most homogeneous and darkest square of 24 cells, as ``even`` and ``dark``; empty if no square is free.

    The homogeneous square has the least variation of means over pieces of 6 cells, in the brighter half of the image.
    These means are nearly independent of the speckle within pieces, so that the choice hardly biases ENL.

    Parameters
    ----------
    image, channel : to search
    points : azimuth and range of targets to be excluded, m of the grid
    """
    grid, sigma0 = image.grid, image.sigma0(channel)
    cells = grid_cells(image, grid.range.size // 2)
    piece = [
        max(1, round(_PIECE * cell / step))
        for cell, step in zip(cells, (grid.azimuth_spacing, grid.range_spacing), strict=True)
    ]
    rows, columns = (n // p for n, p in zip(grid.shape, piece, strict=True))
    n = round(_EDGE / _PIECE)
    if min(rows, columns) < n:
        return ()
    means = block_means(sigma0, (piece[0], piece[1]))
    middle = float(np.median(means))
    taken = np.zeros(means.shape, dtype=bool)
    for azimuth, range_ in points:
        row = round((azimuth - float(grid.azimuth[0])) / grid.azimuth_spacing) // piece[0]
        column = round((range_ - float(grid.range[0])) / grid.range_spacing) // piece[1]
        taken[min(row, rows - 1), min(column, columns - 1)] = True
    best: dict[str, tuple[float, tuple[slice, slice]]] = {}
    for block in windows_over((rows, columns), n):
        part = means[block]
        level = float(part.mean())
        if taken[block].any() or not level > 0.0:
            continue
        for name, score in (("even", float(part.std()) / level), ("dark", level)):
            if name == "even" and level < middle:
                continue
            if name not in best or score < best[name][0]:
                best[name] = (score, block)
    return tuple(
        Area(
            (float(grid.azimuth[b[0].start * piece[0]]), float(grid.azimuth[b[0].stop * piece[0] - 1])),
            (float(grid.range[b[1].start * piece[1]]), float(grid.range[b[1].stop * piece[1] - 1])),
            name,
        )
        for name, b in ((name, best[name][1]) for name in ("even", "dark") if name in best)
    )


# least relative weight of the image's window that is divided out, so that the ends of hann do not amplify noise
_FLOOR = 0.1
# largest share of the sampled spectrum for the image's band
_NYQUIST = 1.0 + 1e-6


@dataclass(frozen=True, eq=False)
class Looks:
    """Mean sigma0 of several looks.

    Parameters
    ----------
    sigma0 : (n_azimuth, n_range) float64, linear, on the image's pixels
    looks : (azimuth, range)
    predicted_enl : equivalent number of looks of homogeneous ground, from the overlap of the looks' bands
    azimuth_cell, range_cell : m of the grid, noise-equivalent, of one look at the image's centre
    """

    sigma0: F64
    looks: tuple[int, int]
    predicted_enl: float
    azimuth_cell: float
    range_cell: float

    def __repr__(self) -> str:
        return (
            f"Looks({self.looks[0]} x {self.looks[1]}: ENL {self.predicted_enl:.3g}, cell {self.azimuth_cell:.3g} m x "
            f"{self.range_cell:.3g} m)"
        )

    def to_db(self) -> F64:
        """Decibels; zero is -inf."""
        return db_from_power(self.sigma0)


def spectral_looks(
    image: SarImage,
    azimuth: int = 1,
    range: int = 1,
    *,
    overlap: float = 0.0,
    channel: str | None = None,
) -> Looks:
    r"""Mean power of sub-apertures (azimuth) and sub-bands (range).

    Without its carrier the processed band of the image is centred at zero; it is divided into parts, each weighted by
    the image's window over the part instead of the section of the whole window. Averaging pixels of one look
    (:meth:`sarmitsuba.SarImage.multilook`) reduces speckle less, since neighbouring pixels are correlated.

    .. math:: \mathrm{ENL} = \frac{n^2}{\sum_{ij} |\rho_{ij}|^2}, \qquad
              \rho_{ij} = \frac{\int W_i W_j}{\sqrt{\int W_i^2 \int W_j^2}}

    Parameters
    ----------
    image : focused
    azimuth, range : numbers of looks
    overlap : share of a look's band common with the next, 0 to 0.9
    channel : default: the first

    Returns
    -------
    Looks; the mean sigma0 of homogeneous ground is preserved, a point is wider and lower

    Raises
    ------
    DataError
        Fewer than one look, an overlap out of bounds, pixels too coarse for the image's band, or more looks than
        resolution cells.

    Notes
    -----
    The band is that of the image's centre; where the cell changes over a wide swath the outermost looks lose a small
    part of theirs. On a ground grid the range band likewise changes with the incidence angle.

    References
    ----------
    Cumming & Wong, Digital Processing of Synthetic Aperture Radar Data, 2005, section 6.5.
    """
    if azimuth < 1 or range < 1 or not 0.0 <= overlap <= 0.9:
        raise DataError(
            f"looks: {azimuth} x {range} with an overlap of {overlap:g}; give at least 1 x 1, and 0 to 0.9"
        )
    grid = image.grid
    cells = grid_cells(image, grid.range.size // 2)
    data = Carrier.of(image).remove_carrier(image.total(channel), slice(None), slice(None))
    sets, widths, enl = [], [], 1.0
    windows = windows_of(image)
    parts = (
        ("azimuth", azimuth, grid.azimuth_spacing, data.shape[0], cells[0], windows[0]),
        ("range", range, grid.range_spacing, data.shape[1], cells[1], windows[1]),
    )
    for name, n, spacing, size, cell, window in parts:
        plain = cell / window.broadening
        if n > size * spacing / plain:
            raise DataError(
                f"looks: {n} looks in {name} exceed the {size * spacing / plain:.3g} cells of the image"
            )
        if n > 1 and spacing / plain > _NYQUIST:
            raise DataError(
                f"looks: pixels of {spacing:g} m in {name} are too coarse for cells of {plain:.3g} m; focus with a "
                "finer --spacing"
            )
        weights, share = _bands(n, scipy.fft.fftfreq(size, spacing) * plain, window, overlap)
        enl *= _enl(weights * window(scipy.fft.fftfreq(size, spacing) * plain)) if n > 1 else 1.0
        sets.append(weights)
        widths.append(cell / share)
    spectrum = scipy.fft.fft2(data, workers=-1)
    total = np.zeros(data.shape)
    for row in sets[0]:
        for column in sets[1]:
            look = scipy.fft.ifft2(spectrum * row[:, None] * column, workers=-1)
            total += look.real**2 + look.imag**2
    n_looks = azimuth * range
    return Looks(
        total / (n_looks * image.cell_area),
        (azimuth, range),
        enl,
        widths[0],
        widths[1],
    )


def _bands(n: int, u: F64, window: Window, overlap: float) -> tuple[F64, float]:
    """Weights of each look over the FFT bins, (n, size), and a look's share of the band.

    Scaled so that the mean power of clutter is preserved.

    Parameters
    ----------
    n : looks
    u : (size,) frequencies of the bins, -1/2 ... 1/2 over the band
    window : of the image
    overlap : share of a look's band common with the next
    """
    if n == 1:
        return np.ones((1, u.size)), 1.0
    share = 1.0 / (n - (n - 1) * overlap)
    centers = -0.5 + share * (0.5 + (1.0 - overlap) * np.arange(n))
    whole = window(u)
    inverse = np.where(np.abs(u) <= 0.5, 1.0 / np.maximum(whole, _FLOOR * float(window(0.0))), 0.0)
    weights = window((u - centers[:, None]) / share) * inverse
    level = np.sum((weights * whole) ** 2, axis=1, keepdims=True)
    if not level.min() > 0.0:
        raise DataError(f"looks: {n} looks exceed the bins of the image's spectrum; give fewer")
    return np.asarray(weights * np.sqrt(np.sum(whole**2) / level)), share


def _enl(bands: F64) -> float:
    """Equivalent number of looks of bands, (n, size), for a white spectrum."""
    cross = bands @ bands.T
    norm = np.sqrt(np.outer(np.diag(cross), np.diag(cross)))
    return float(bands.shape[0] ** 2 / np.sum((cross / norm) ** 2))


@dataclass(frozen=True)
class QualityReport:
    """Measured image quality.

    Parameters
    ----------
    channel : polarisation
    points : point targets
    areas : rectangles
    looks : (azimuth, range) used for the areas
    contrast, entropy : of the whole image's intensity
    nesz_db : predicted noise-equivalent sigma0 at the image's centre; NaN without noise
    darkest_db : mean sigma0 of the darkest area, an upper bound of the noise in the image; NaN without such an area
    left_out : one line for each point that could not be measured
    calibrated : whether radar cross sections and sigma0 are absolute, see `SarImage.calibrated`
    """

    channel: str
    points: tuple[PointQuality, ...]
    areas: tuple[AreaQuality, ...]
    looks: tuple[int, int]
    contrast: float
    entropy: float
    nesz_db: float
    darkest_db: float
    left_out: tuple[str, ...]
    calibrated: bool = True

    def as_dict(self) -> dict[str, object]:
        """Values for JSON, units in the names; None for those not measured."""
        return {
            "channel": self.channel,
            "calibrated": self.calibrated,
            "looks": list(self.looks),
            "contrast": self.contrast,
            "entropy_nats": self.entropy,
            "nesz_predicted_db": _or_none(self.nesz_db),
            "darkest_area_db": _or_none(self.darkest_db),
            "points": [_point_dict(point) for point in self.points],
            "areas": [_area_dict(area) for area in self.areas],
            "left_out": list(self.left_out),
        }

    def as_table(self) -> str:
        """Tables for a terminal."""
        lines: list[str] = []
        if not self.calibrated:
            lines += ["uncalibrated data: RCS and sigma0 are up to one unknown factor", ""]
        if self.points:
            lines += _table(_PLACE_COLUMNS, [_place_row(p) for p in self.points])
            lines += ["", *_table(_RESPONSE_COLUMNS, [_response_row(p) for p in self.points])]
        elif not self.left_out:
            lines.append("no isolated point target found")
        lines += [f"left out: {text}" for text in self.left_out]
        if self.areas:
            lines += ["", *_table(_AREA_COLUMNS, [_area_row(a) for a in self.areas])]
        lines += ["", f"whole image: contrast {self.contrast:.3f}, entropy {self.entropy:.3f} nats"]
        lines.append(
            f"NESZ predicted {_number(self.nesz_db, '.2f')} dB{' (no noise)' * math.isnan(self.nesz_db)}, darkest area "
            f"{_number(self.darkest_db, '.2f')} dB"
        )
        return "\n".join(lines)


_PLACE_COLUMNS = (
    "point",
    "azimuth m",
    "range m",
    "error az m",
    "error rg m",
    "RCS dBsm",
    "error dB",
    "phase deg",
    "error deg",
)
_RESPONSE_COLUMNS = (
    "point",
    *(f"{text} {axis}" for axis in ("az", "rg") for text in ("IRW m", "predicted m", "PSLR dB", "ISLR dB")),
)
_AREA_COLUMNS = (
    "area",
    "azimuth m",
    "range m",
    "sigma0 dB",
    "ENL",
    "ENL predicted",
    "contrast",
    "entropy",
    "ln N - entropy",
)


def image_quality(
    image: SarImage,
    points: Sequence[KnownPoint | tuple[float, float, float]] | None = None,
    areas: Sequence[Area] | None = None,
    *,
    channel: str | None = None,
    looks: tuple[int, int] = (1, 1),
    most: int = 12,
) -> QualityReport:
    """Measure the quality of an image.

    Parameters
    ----------
    image : focused
    points : point targets, or their positions x, y, z, m, in the frame of the scene's file; None: the scene's point
        scatterers if recorded in the image, else the brightest points found
    areas : rectangles; None: the most homogeneous and the darkest square
    channel : default: the first
    looks : numbers of looks in azimuth and range for the areas, see
        :func:`sarmitsuba.analysis.image_quality.spectral_looks`
    most : largest number of points to find

    Raises
    ------
    DataError
        Unknown channel, an area outside the image, too many looks, or an image of a circular aperture.

    Notes
    -----
    IRW: half-power width. PSLR: highest side lobe beyond the first nulls over the peak. ISLR: energy beyond the first
    nulls over that between them, along the lobe, to 16 cells. Widths are along the lobes, which squint rotates.
    """
    if points is not None and not points:
        raise DataError("quality: the list of points is empty; give points, or leave it out to find them")
    known = (
        scene_points(image, channel) if points is None else [_describe_known_point(point) for point in points]
    )
    left_out: tuple[str, ...] = ()
    if known:
        measured, left_out = measure_known(image, known, channel)
    else:
        measured = find_points(image, channel, most)
    sigma0 = image.sigma0(channel)
    places = [(point.azimuth, point.range) for point in measured]
    rectangles = automatic_areas(image, channel, places) if areas is None else tuple(areas)
    shown, enl, larger = sigma0, 1.0, 1.0
    if looks != (1, 1):
        done = spectral_looks(image, looks[0], looks[1], channel=channel)
        shown, enl, larger = done.sigma0, done.predicted_enl, float(looks[0] * looks[1])
    found = tuple(
        measure_area(
            image,
            area if area.name else dataclasses.replace(area, name=f"area {i + 1}"),
            shown,
            enl,
            larger,
        )
        for i, area in enumerate(rectangles)
    )
    noise = image.metadata.get("focus", {}).get("nesz")
    power = image.rcs(channel)
    return QualityReport(
        channel=channel or image.channels[0],
        points=measured,
        areas=found,
        looks=looks,
        contrast=contrast(power),
        entropy=entropy(power),
        nesz_db=db_from_power(noise) if noise else math.nan,
        darkest_db=min((area.sigma0_db for area in found), default=math.nan),
        left_out=left_out,
        calibrated=image.calibrated,
    )


def describe_weak_echoes(image: SarImage) -> tuple[str, ...]:
    """Notes on channels without echoes, and on noise above the level of the ground; with a remedy each.

    The level of the ground is that of exponentially distributed power with the image's median, less the noise's power
    at the image's centre. It is below the noise where nine tenths of the image, averaged over blocks, are.

    Notes
    -----
    Ignores the change of the noise over the image. Where walls are seen on a tenth of it, dark ground is not told.
    """
    noise = image.metadata.get("focus", {}).get("nesz", 0.0)
    sigma0 = {channel: image.sigma0(channel) for channel in image.channels}
    mean = {channel: max(float(power.mean()) - noise, 0.0) for channel, power in sigma0.items()}
    least = max(power_from_db(EMPTY_DB) * max(mean.values()), _NOISE_SHARE * noise)
    empty = [channel for channel, power in mean.items() if power <= least]
    notes = []
    if empty and len(empty) < len(mean):
        notes.append(
            f"{', '.join(empty)}: no echo, {'noise' if noise else 'rounding'} alone; cross-polar echoes come from "
            "materials with a cross_polar_ratio_db, from vegetation, tilted wires and tilted walls"
        )
    for channel in image.channels:
        ground = float(np.median(sigma0[channel])) / math.log(2.0) - noise
        seen = float(np.percentile(block_means(sigma0[channel], _blocks(image)), 90.0)) - noise
        if channel not in empty and noise > 0.0 and max(ground, seen) < noise and _has_clutter(image):
            level = f"at {db_from_power(ground):.1f} dB" if ground > _NOISE_SHARE * noise else "not seen"
            notes.append(
                f"{channel}: the ground is {level}, below the noise, NESZ {db_from_power(noise):.1f} dB at the image's "
                "centre: its texture is noise; more power, a larger antenna or a lower noise_temperature shows it; "
                "`link` has the budget"
            )
    return tuple(notes)


def _blocks(image: SarImage) -> tuple[int, int]:
    """Pixels of blocks whose mean power hardly scatters, fewer in small images."""
    return max(min(_BLOCK, image.grid.shape[0] // 4), 1), max(min(_BLOCK, image.grid.shape[1] // 4), 1)


def _has_clutter(image: SarImage) -> bool:
    effect = image.metadata.get("effects", {}).get("effects", {}).get("diffuse", {})
    return effect.get("on") is True


def _describe_known_point(point: KnownPoint | tuple[float, float, float]) -> KnownPoint:
    return point if isinstance(point, KnownPoint) else KnownPoint(point)


def _point_dict(point: PointQuality) -> dict[str, object]:
    cuts = {
        f"{name}_{key}": _or_none(value)
        for name, cut in (("azimuth", point.azimuth_cut), ("range", point.range_cut))
        for key, value in (
            ("irw_m", cut.irw),
            ("pslr_db", cut.pslr_db),
            ("islr_null_db", cut.islr_null_db),
            ("islr_2irw_db", cut.islr_2irw_db),
            ("islr_20irw_db", cut.islr_20irw_db),
        )
    }
    return {
        "name": point.name,
        "azimuth_m": point.azimuth,
        "range_m": point.range,
        "position_m": list(point.position),
        "azimuth_error_m": _or_none(point.azimuth_error),
        "range_error_m": _or_none(point.range_error),
        "rcs_m2": point.rcs,
        "rcs_error_db": _or_none(point.rcs_error_db),
        "phase_rad": point.phase,
        "phase_error_rad": _or_none(point.phase_error),
        "background_db": _or_none(point.background_db),
        **cuts,
        "azimuth_irw_predicted_m": point.predicted_irw[0],
        "range_irw_predicted_m": point.predicted_irw[1],
    }


def _area_dict(area: AreaQuality) -> dict[str, object]:
    return {
        "name": area.name,
        "azimuth_m": list(area.azimuth),
        "range_m": list(area.range),
        "pixels": area.pixels,
        "cells": area.cells,
        "sigma0_db": _or_none(area.sigma0_db),
        "enl": _or_none(area.enl),
        "enl_sigma": _or_none(area.enl_sigma),
        "enl_predicted": area.predicted_enl,
        "contrast": area.contrast,
        "entropy_nats": area.entropy,
        "entropy_deficit_nats": area.entropy_deficit,
    }


def _place_row(p: PointQuality) -> tuple[str, ...]:
    return (
        p.name,
        f"{p.azimuth:.3f}",
        f"{p.range:.3f}",
        _number(p.azimuth_error, ".4f"),
        _number(p.range_error, ".4f"),
        f"{db_from_power(p.rcs):.2f}",
        _number(p.rcs_error_db, ".2f"),
        f"{math.degrees(p.phase):.1f}",
        _number(math.degrees(p.phase_error), ".1f"),
    )


def _response_row(p: PointQuality) -> tuple[str, ...]:
    cuts = zip((p.azimuth_cut, p.range_cut), p.predicted_irw, strict=True)
    return (
        p.name,
        *(
            text
            for cut, irw in cuts
            for text in (f"{cut.irw:.4f}", f"{irw:.4f}", f"{cut.pslr_db:.2f}", f"{cut.islr_null_db:.2f}")
        ),
    )


def _area_row(a: AreaQuality) -> tuple[str, ...]:
    return (
        a.name,
        f"{a.azimuth[0]:.1f} ... {a.azimuth[1]:.1f}",
        f"{a.range[0]:.1f} ... {a.range[1]:.1f}",
        f"{a.sigma0_db:.2f}",
        f"{a.enl:.3f} +- {a.enl_sigma:.3f}",
        f"{a.predicted_enl:.3f}",
        f"{a.contrast:.3f}",
        f"{a.entropy:.3f}",
        f"{a.entropy_deficit:.3f}",
    )


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "-"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    return [
        "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True))
        for row in (header, *rows)
    ]
