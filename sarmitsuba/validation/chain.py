"""Scenes built in memory for validation, and the whole chain on them: trace, chirp, compress, focus, calibrate."""

import warnings
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.echo.chirp import to_chirped
from sarmitsuba.errors import SarmitsubaWarning
from sarmitsuba.focusing import focus
from sarmitsuba.image.sar_image import SarImage
from sarmitsuba.loader import tables
from sarmitsuba.loader.radar_builder import RadarInput, build_radar
from sarmitsuba.materials.material import Material
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.raw import simulate

F64 = NDArray[np.float64]


def make_scene(
    geometry: Geometry | None,
    materials: tuple[Material, ...] = (),
    *,
    points: Sequence[PointTarget] = (),
    settings: TraceSettings | None = None,
    **parameters: Any,
) -> Scene:
    """Scene from geometry and points in memory; ``parameters`` are those of ``sar_antenna`` and ``range_film``."""
    geometry = geometry or Geometry.empty()
    film = {k: v for k, v in parameters.items() if k in tables.FILM.names}
    sensor = {k: v for k, v in parameters.items() if k not in film}
    given = RadarInput(
        tables.SENSOR.read(sensor, "sar_antenna"),
        tables.FILM.read(film, "range_film"),
        frozenset(sensor),
        frozenset(film),
    )
    clouds = [np.asarray([p.position for p in points])] if points else []
    if geometry.n_faces:
        clouds.append(geometry.vertices)
    cloud = np.concatenate(clouds)
    radar, image, notes = build_radar(given, np.stack([cloud.min(axis=0), cloud.max(axis=0)]))
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


def chain(
    scene: Scene,
    *,
    chirped: bool = False,
    method: Literal["backprojection", "omega_k"] = "backprojection",
    window: str = "rectangular",
    seed: int | None = None,
) -> SarImage:
    """Simulate and focus; ``chirped`` goes through real LFM echoes and range compression.

    Warnings about effects and rays are left out: the cases choose both on purpose.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SarmitsubaWarning)
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


__all__ = ["chain", "make_scene", "track_distance"]
