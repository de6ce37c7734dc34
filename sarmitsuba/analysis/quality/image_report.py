"""Report of image quality: points, areas, noise."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

from sarmitsuba.analysis.quality.areas import (
    Area,
    AreaQuality,
    automatic_areas,
    contrast,
    entropy,
    measure_area,
)
from sarmitsuba.analysis.quality.looks import spectral_looks
from sarmitsuba.analysis.quality.point_quality import (
    KnownPoint,
    PointQuality,
    find_points,
    measure_known,
    scene_points,
)
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image.sar_image import SarImage


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
            f"NESZ predicted {_number(self.nesz_db, '.2f')} dB, darkest area {_number(self.darkest_db, '.2f')} dB"
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
        :func:`sarmitsuba.analysis.quality.spectral_looks`
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
    known = scene_points(image, channel) if points is None else [_known(point) for point in points]
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
        nesz_db=10.0 * math.log10(noise) if noise else math.nan,
        darkest_db=min((area.sigma0_db for area in found), default=math.nan),
        left_out=left_out,
        calibrated=image.calibrated,
    )


def _known(point: KnownPoint | tuple[float, float, float]) -> KnownPoint:
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
        f"{10.0 * math.log10(p.rcs):.2f}",
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
