"""Scenes built in memory for validation, and the whole chain on them: trace, chirp, compress, focus, calibrate."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.loading import tables
from sarmitsuba.radar.builder import build_radar
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.image_request import Extent
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.chirp import to_chirped
from sarmitsuba.signal.focusing import focus
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth.validation import targets

# of ``sar_antenna`` and ``range_film``, as a scene file gives them
Parameter = float | str | bool
Method = Literal["backprojection", "omega_k"]
METHODS: tuple[Method, ...] = ("backprojection", "omega_k")
WINDOWS = ("rectangular", "hamming", "taylor:4:-35", "kaiser:2.5")
RCS_DBSM = 7.0


def make_scene(
    geometry: Geometry | None,
    materials: tuple[Material, ...],
    parameters: Mapping[str, Parameter],
    *,
    points: Sequence[PointTarget] = (),
    settings: TraceSettings | None = None,
) -> Scene:
    """Scene from geometry and points in memory; ``parameters`` are those of ``sar_antenna`` and ``range_film``."""
    geometry = geometry or Geometry.empty()
    film = {k: v for k, v in parameters.items() if k in tables.FILM.names}
    sensor = {k: v for k, v in parameters.items() if k not in film}
    given = RadarInput.read(sensor, film)
    clouds = [np.asarray([p.position for p in points])] if points else []
    if geometry.n_faces:
        clouds.append(geometry.vertices)
    cloud = np.concatenate(clouds)
    # the cases stand about the origin, and their images with them
    radar, image, notes = build_radar(given, Extent(cloud, np.zeros(3)))
    return Scene(
        "validation",
        None,
        geometry,
        materials,
        tuple(points),
        radar,
        settings or TraceSettings(),
        image,
        notes=notes,
    )


@contextmanager
def suppress_warnings() -> Iterator[None]:
    """Suppress the program's warnings about settings that a case chooses on purpose."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SarmitsubaWarning)
        yield


def chain(
    scene: Scene,
    *,
    chirped: bool = False,
    method: Method = "backprojection",
    window: str = "rectangular",
    seed: int | None = None,
) -> SarImage:
    """Simulate and focus; ``chirped`` goes through real LFM echoes and range compression.

    Warnings about effects and rays are left out: the cases choose both on purpose.
    """
    with suppress_warnings():
        raw = simulate(scene, seed=seed)
    if chirped:
        raw = to_chirped(raw)
    return focus(raw, request=scene.image, focuser=method, range_window=window, azimuth_window=window)


def track_distance(radar: Radar, points: ArrayLike) -> F64:
    """Distance of points from the line of flight, m: the slant range at which a straight track focuses them."""
    along = radar.track.velocity[radar.track.center_index]
    along = along / np.linalg.norm(along)
    leg = np.asarray(points, dtype=np.float64) - radar.track.center_position
    return np.asarray(np.linalg.norm(leg - (leg @ along)[..., None] * along, axis=-1))


def bandwidth(resolution: float) -> float:
    """Bandwidth of a slant-range cell, Hz."""
    return SPEED_OF_LIGHT / (2.0 * resolution)


def point_scene(slant_range: float, resolution: float, **changes: Parameter) -> Scene:
    """An ideal point of 7 dBsm somewhere off the aim point, X band."""
    cell = resolution
    parameters: dict[str, Parameter] = {
        "slant_range": slant_range,
        "look_angle_deg": 40.0,
        "azimuth_resolution": resolution,
        "bandwidth": bandwidth(resolution),
        "center_frequency": 9.65e9,
        "speed": 7500.0 if slant_range > 200e3 else 150.0,
        "image_extent_azimuth": 48.0 * cell,
        "image_extent_range": 72.0 * cell,
        **changes,
    }
    point = PointTarget("point", np.array([3.3 * cell, -2.7 * cell, 0.4 * cell]), power_from_db(RCS_DBSM))
    return make_scene(None, (), parameters, points=(point,))


def peak_dbsm(image: SarImage) -> float:
    """Calibrated peak of the brightest target, dBsm."""
    return db_from_power(point_target_in(image).rcs)


def ground_scene(
    look_angle_deg: float,
    cell: float,
    slant_range: float,
    level: float,
    n_cells: float = 128.0,
    *,
    settings: TraceSettings | None = None,
    **changes: Parameter,
) -> Scene:
    """Flat diffuse ground of constant sigma0 that overfills the image."""
    ground_cell = cell / np.sin(np.radians(look_angle_deg))
    height, width = n_cells * cell, n_cells * ground_cell
    margin = 1.25
    material = Material(
        "ground", permittivity=5.0 - 0.5j, diffuse_law="constant", diffuse_level_db=level, rms_height=0.1
    )
    geometry = targets.plate(width * margin, height * margin)
    parameters: dict[str, Parameter] = {
        "slant_range": slant_range,
        "look_angle_deg": look_angle_deg,
        "azimuth_resolution": cell,
        "bandwidth": bandwidth(cell),
        "center_frequency": 9.65e9,
        "speed": 7500.0 if slant_range > 200e3 else 150.0,
        "image_extent_azimuth": height,
        "image_extent_range": width,
        **changes,
    }
    return make_scene(geometry, (material,), parameters, settings=settings or TraceSettings(max_depth=1))
