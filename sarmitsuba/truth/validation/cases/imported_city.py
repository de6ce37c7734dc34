"""Positions of the roofs of a city imported from footprints."""

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import EARTH_FLATTENING, EARTH_RADIUS
from sarmitsuba.loading.importing.convert import import_scene
from sarmitsuba.loading.importing.facades import FacadeOptions
from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import chain, track_distance
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.slant_profiles import BLACK, BRIGHT, SLANT_RANGE, diffuse_only, incidence

# m: between middles, so that no roof is in another's shadow or layover; cells; beside a roof in what is measured
PITCH, CELL, RIM = 58.0, 0.5, 1.0
# the centroid of n cells of speckle on a length l is off by l / sqrt(12 n), 0.29 cells on a square; four times that
WHERE = "four standard deviations of the centroid of a roof's speckle"
TOLERANCE = 4.0 * 0.29 * CELL
MATERIALS = {"walls": "concrete", "roofs": "brick", "ground": "medium_dry_ground"}
_DEGREE = np.pi / 180.0


def _city(rng: np.random.Generator, n: int, latitude: float, longitude: float) -> tuple[str, F64, F64]:
    """GeoJSON of n x n houses turned anyhow, (n n, 4, 2) corners in m about the middle of their bounds, and heights.

    Degrees are those of the ellipsoid's two radii of curvature, exact to a millimetre over a few streets.
    """
    square = EARTH_FLATTENING * (2.0 - EARTH_FLATTENING)
    root = np.sqrt(1.0 - square * np.sin(latitude * _DEGREE) ** 2)
    east = EARTH_RADIUS / root * np.cos(latitude * _DEGREE)
    north = EARTH_RADIUS * (1.0 - square) / root**3
    corners, heights = [], np.round(rng.uniform(6.0, 12.0, n * n), 1)
    for i in range(n * n):
        middle = PITCH * (np.array([i % n, i // n]) - 0.5 * (n - 1)) + rng.uniform(-2.0, 2.0, 2)
        turn = rng.uniform(0.0, np.pi)
        axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        corners.append(
            middle + 0.5 * rng.uniform(12.0, 18.0, 2) * [[-1, -1], [1, -1], [1, 1], [-1, 1]] @ axes
        )
    outlines = np.asarray(corners)
    outlines -= 0.5 * (outlines.min(axis=(0, 1)) + outlines.max(axis=(0, 1)))
    places = outlines / (np.array([east, north]) * _DEGREE) + [longitude, latitude]
    features = [
        {
            "type": "Feature",
            "properties": {"building": "yes", "height": height},
            "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]]]},
        }
        for ring, height in zip(places.tolist(), heights.tolist(), strict=True)
    ]
    return json.dumps({"type": "FeatureCollection", "features": features}), outlines, heights


def imported_city(quick: bool = False) -> Case:
    """Roofs of cities drawn at random, seen from random headings, against the plane-wave layover of their outlines."""
    wanted: dict[str, list[float]] = {"slant range": [], "azimuth": []}
    got: dict[str, list[float]] = {"slant range": [], "azimuth": []}
    for seed in range(1 if quick else 4):
        rng = np.random.default_rng(seed)
        text, outlines, heights = _city(rng, 2, *rng.uniform([-60.0, -170.0], [60.0, 170.0]))
        parameters = {
            "slant_range": SLANT_RANGE,
            "heading_deg": rng.uniform(0.0, 360.0),
            "look_angle_deg": rng.uniform(38.0, 48.0),
            "look_side": ("left", "right")[int(rng.integers(2))],
            "azimuth_resolution": CELL,
            "aim_x": 0.0,
            "aim_y": 0.0,
            "aim_z": 0.0,
            "speed": 150.0,
        }
        with tempfile.TemporaryDirectory() as folder:
            source, output = Path(folder) / "city.geojson", Path(folder) / "city.xml"
            source.write_text(text)
            import_scene(
                source, output, ImportOptions(materials=MATERIALS, facades=FacadeOptions.read("none", 1, {}))
            )
            given = {f"sar_antenna.{name}": str(value) for name, value in parameters.items()}
            film = {"image_grid": "slant", "image_extent_azimuth": "140", "image_extent_range": "150"}
            given |= {f"range_film.{name}": value for name, value in film.items()}
            scene = load_scene(output, parameters=given)
        roofs = tuple(BRIGHT if m.name == MATERIALS["roofs"] else BLACK for m in scene.materials)
        settings = diffuse_only(TraceSettings(max_depth=1))
        scene = replace(scene, materials=roofs, settings=settings)
        image = chain(scene)
        power = np.abs(image.data.sum(axis=0)) ** 2
        track = scene.radar.track
        along = track.velocity[track.center_index] / np.linalg.norm(track.velocity[track.center_index])
        origin = -np.asarray(scene.offset)
        sight = origin - track.center_position
        level = sight - (sight @ along) * along
        look = level / np.linalg.norm(level)
        angle = incidence(scene)
        for outline, height in zip(outlines, heights, strict=True):
            foot = np.column_stack([outline, np.zeros(len(outline))])
            layover = theory.building_returns(float(height), 1.0, angle).layover_slant
            slant = theory.slant_offset(foot, look) - layover
            azimuth = foot @ along
            want = slant.mean(), azimuth.mean()
            ranges = image.grid.range - float(track_distance(scene.radar, origin))
            places = image.grid.azimuth
            near_r = np.abs(ranges - want[0]) < 0.5 * np.ptp(slant) + RIM
            near_a = np.abs(places - want[1]) < 0.5 * np.ptp(azimuth) + RIM
            box = power[np.ix_(near_a, near_r)]
            got["slant range"].append(float((box.sum(axis=0) @ ranges[near_r]) / box.sum()))
            got["azimuth"].append(float((box.sum(axis=1) @ places[near_a]) / box.sum()))
            wanted["slant range"].append(float(want[0]))
            wanted["azimuth"].append(float(want[1]))
    comparisons = tuple(
        Comparison(
            name,
            np.arange(len(wanted[name]), dtype=np.float64),
            np.asarray(wanted[name]),
            np.asarray(got[name]),
            tolerance=TOLERANCE,
            reason=WHERE,
            unit="m",
            shown=0,
        )
        for name in wanted
    )
    return Case(
        name="imported_city",
        topic="geometry",
        title="Roofs of a city imported from footprints",
        formula="slant range x.u - h cos t, azimuth x.v of the middle of the outline",
        source="plane-wave geometry of layover",
        x_label="building",
        y_label="place of the roof relative to the origin (m)",
        comparisons=comparisons,
        note="GeoJSON outlines at random places on the Earth, turned at random, seen from random headings and sides; "
        f"cell {CELL:g} m. Only roofs reflect.",
    )


CASES.register(CaseEntry("imported_city", "geometry", imported_city))
