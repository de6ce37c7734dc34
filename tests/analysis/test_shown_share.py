"""Share of the echoes' energy that an image shows, and what errors over the echoes' energy are over the image's."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import PointTarget, RadarDescription, build_scene, error_budget, simulate
from sarmitsuba.analysis.error_budget import ErrorPart
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import SarImage
from tests.support.unweighted import focus


def points(*places: tuple[float, float, float], **radar: object) -> Scene:
    """Points at (x, y) of so many dBsm."""
    given = {"slant_range": 3e3, "bandwidth": 100e6, "azimuth_resolution": 1.5, "heading_deg": 90.0} | radar
    found = [
        PointTarget(f"p{i}", np.array([x, y, 0.0]), 10.0 ** (0.1 * level))
        for i, (x, y, level) in enumerate(places)
    ]
    film = FilmDescription(image_extent_azimuth=90.0, image_extent_range=90.0)
    return build_scene([], found, radar=RadarDescription(**given), film=film)  # type: ignore[arg-type]


def shown(image: SarImage) -> float:
    return float(image.metadata["focus"]["shown_energy_db"])


def gridding(image: SarImage) -> ErrorPart:
    """Error of gridding as if something had been traced: ideal points are not gridded."""
    traced = replace(image, metadata={**image.metadata, "statistics": {"rays": 7}})
    return next(part for part in error_budget(traced) if part.name == "gridding")


@pytest.mark.parametrize("grid", ["slant", "ground"])
@pytest.mark.parametrize("window", ["rectangular", "taylor:4:-35"])
@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
def test_all_of_what_stands_within(grid: str, window: str, mode: str) -> None:
    raw = simulate(points((2.0, -3.0, 0.0), mode=mode, squint_angle_deg=4.0 if mode == "spotlight" else 0.0))
    image = focus(raw, request={"grid": grid}, range_window=window, azimuth_window=window)
    assert shown(image) == pytest.approx(0.0, abs=0.3)  # tol: side lobes beyond the image


@pytest.mark.parametrize("place", [(0.0, 30.0), (30.0, 0.0)])
def test_a_bright_point_beside_the_image(place: tuple[float, float]) -> None:
    raw = simulate(points((1.0, 2.0, 0.0), (*place, 20.0)))
    image = focus(
        raw,
        request={"extent_azimuth": 24.0, "extent_range": 24.0, "center_x": 1.0, "center_y": 2.0},
        range_window="taylor:4:-35",
        azimuth_window="taylor:4:-35",
    )
    assert shown(image) == pytest.approx(-20.0, abs=1.0)  # tol: side lobes of the bright one
    plain, part = (gridding(one) for one in (focus(raw), image))
    assert part.known == "bound" and "the image shows" in part.why
    assert part.error_db - plain.error_db == pytest.approx(-shown(image))


def test_noise_tells_nothing() -> None:
    image = focus(simulate(points((1.0, 2.0, 0.0), noise_temperature=300.0)))
    assert "shown_energy_db" not in image.metadata["focus"]
