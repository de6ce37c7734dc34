"""Azimuth ambiguities of ground: its level where only ghosts are, against the closed form."""

import numpy as np
import pytest

from sarmitsuba.analysis.pulse_timing import azimuth_ambiguity_ratio
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from tests.support.unweighted import focus

SOIL = {
    "material": "medium_dry_ground",
    "rms_height": 0.05,
    "diffuse_law": "constant",
    "diffuse_level_db": -10.0,
}


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # of the prf, which is the point
@pytest.mark.parametrize("seed", range(3))
def test_ground_shows_the_level_of_its_ghosts(seed: int) -> None:
    # Rationale: a strip of ground 60 m long leaves ghosts lambda R PRF / 2 v away, each of the textbook's ratio of its
    # order; a fine range cell smears them in range, which does not change the mean level.
    rng = np.random.default_rng([51, seed])
    prf, error = float(rng.uniform(75.0, 95.0)), float(rng.uniform(-0.2, 0.2))
    length, speed, distance = 2.0, 100.0, 10e3
    radar = RadarDescription(
        mode="stripmap",
        pattern="rectangular",
        antenna_length=length,
        antenna_height=0.1,
        slant_range=distance,
        look_angle_deg=float(rng.uniform(35.0, 50.0)),
        azimuth_resolution=1.2,
        bandwidth=100e6,
        speed=speed,
        prf=prf,
        pointing_error_azimuth_deg=error,
        aim_x=0.0,
        aim_y=0.0,
    )
    corners = np.array([[-60.0, -30.0, 0.0], [60.0, -30.0, 0.0], [60.0, 30.0, 0.0], [-60.0, 30.0, 0.0]])
    scene = build_scene(
        [SceneMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), SOIL, "ground")],
        radar=radar,
        film=FilmDescription(image_extent_azimuth=360.0, image_extent_range=50.0),
    )
    image = focus(simulate(scene, seed=seed))
    told = scene.radar.as_recorded()
    lam = told.waveform.wavelength
    apart = theory.azimuth_ghost(lam, distance, prf, speed)[0]
    gain = theory.uniform_aperture_gain(length, lam)
    sigma0, place = image.sigma0().mean(axis=1), image.grid.azimuth - image.grid.azimuth.mean()

    def level(center: float) -> float:
        return float(sigma0[np.abs(place - center) < 22.0].mean())

    band = 4.0 * speed / lam * told.half_aperture
    sides = []
    for order in (-1, 1):
        # of one order alone: two radars whose ambiguities differ by it
        sine = np.linspace(-told.half_aperture, told.half_aperture, 4001)
        weight = gain(sine) ** 2
        off = np.radians(error)
        ghost = np.sum(weight * gain(sine - order * lam * prf / (2.0 * speed) - off) ** 2)
        sides.append(ghost / np.sum(weight * gain(sine - off) ** 2))
        measured = level(order * apart) / level(0.0)
        # tol: speckle of about 800 looks in each, 0.22 dB of their ratio, three sigma
        assert 10.0 * np.log10(measured / sides[-1]) == pytest.approx(0.0, abs=0.66)
    whole = azimuth_ambiguity_ratio(
        gain, lam, prf, speed, band, weighting="matched", pointing_error=np.radians(error), orders=1
    )
    assert sum(sides) == pytest.approx(whole, rel=1e-3)  # tol: angles for sines
