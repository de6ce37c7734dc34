"""Points off the image plane near the edge of the beam in elevation: their error of level, and that it is said."""

import warnings

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.height_error import NOTED_DB, WARNED_DB
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.simulation.execution.render import simulate
from tests.support.draws import few_of
from tests.support.unweighted import focus


def drawn(mode: str, seed: int, height: float, pattern: str = "gaussian") -> Scene:
    """A point of 0 dB at a height over the image's plane, near the edge of a beam that is drawn."""
    rng = np.random.default_rng([seed, len(mode)])
    slant, look, width = rng.uniform(1.5e3, 3e3), rng.uniform(35.0, 50.0), rng.uniform(3.0, 5.0)
    heading, side = rng.uniform(-180.0, 180.0), str(rng.choice(["left", "right"]))
    turn = np.radians(heading)
    across = np.array([np.cos(turn), -np.sin(turn), 0.0]) * (1.0 if side == "right" else -1.0)
    # across the line of sight, to the beam's half power and beyond
    off = rng.uniform(0.5, 0.8) * np.radians(0.5 * width) * slant / np.cos(np.radians(look))
    beam = {} if pattern == "isotropic" else {"elevation_beamwidth_deg": width, "azimuth_beamwidth_deg": 2.0}
    return build_scene(
        points=[PointTarget("p", off * across + [0.0, 0.0, height], 1.0)],
        radar=RadarDescription(
            mode=mode,
            slant_range=slant,
            look_angle_deg=look,
            heading_deg=heading,
            look_side=side,
            aim_x=0.0,
            aim_y=0.0,
            aim_z=0.0,
            squint_angle_deg=rng.uniform(-8.0, 8.0),
            center_frequency=9.65e9,
            bandwidth=0.5 * SPEED_OF_LIGHT,
            azimuth_resolution=1.0,
            pattern=pattern,
            **beam,
        ),
        film=FilmDescription(
            image_center_x=float((off - height / np.tan(np.radians(look))) * across[0]),
            image_center_y=float((off - height / np.tan(np.radians(look))) * across[1]),
            image_height=0.0,
            image_extent_azimuth=20.0,
            image_extent_range=40.0,
        ),
    )


@pytest.mark.parametrize("height", few_of([-15.0, 2.0, 30.0]))
@pytest.mark.parametrize("mode", ["stripmap", "sliding_spotlight", "spotlight"])
def test_level_of_a_point_off_the_plane_is_what_the_note_says(mode: str, height: float) -> None:
    scene = drawn(mode, int(height) + 20, height)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SarmitsubaWarning)
        raw = simulate(scene)
    said = [note for note in raw.metadata["notes"] if "over the image plane" in note]
    level = 10.0 * np.log10(point_target_in(focus(raw, request=scene.image)).rcs)
    if not said:
        assert abs(level) < NOTED_DB + 0.05
        return
    stated = float(said[0].split("off by up to ")[1].split(" dB")[0])
    # tol: two digits are stated; the pattern over the aperture at another height
    assert level == pytest.approx(stated, abs=0.05 + 0.05 * abs(level))
    assert f"at {height:.3g} m" in said[0]
    warned = any("over the image plane" in str(w.message) for w in caught)
    assert warned == (abs(stated) >= WARNED_DB)


@pytest.mark.parametrize(("height", "pattern"), [(0.0, "gaussian"), (30.0, "isotropic")])
def test_nothing_is_said_where_nothing_is_off(height: float, pattern: str) -> None:
    scene = drawn("stripmap", 3, height, pattern)
    raw = simulate(scene)
    assert not any("over the image plane" in note for note in raw.metadata["notes"])
    level = 10.0 * np.log10(point_target_in(focus(raw, request=scene.image)).rcs)
    assert abs(level) < 0.05  # tol: the cut receive window
