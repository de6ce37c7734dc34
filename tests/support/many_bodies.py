"""Drawn scenes with many parameters: boxes on ground whose level varies by a map."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from sarmitsuba import (
    FilmDescription,
    Material,
    RadarDescription,
    Scene,
    SceneMesh,
    TraceSettings,
    build_scene,
)
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.scene.materials.material import SurfaceMaps
from sarmitsuba.scene.materials.texture import Bitmap, place_in_plan

CORNERS = [(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)]
QUADS = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
FACES = np.array([triangle for a, b, c, d in QUADS for triangle in ((a, b, c), (a, c, d))])


def city(
    seed: int,
    bodies: int,
    *,
    pitch: float = 12.0,
    texels: tuple[int, int] = (0, 0),
    levels: F64 | None = None,
    kind: str = "rough",
    radar: dict[str, Any] | None = None,
    settings: dict[str, Any] | None = None,
) -> Scene:
    """Boxes drawn on a square grid of streets, on ground; every third with a sloping roof.

    Parameters
    ----------
    seed : of sizes, places, materials and radar
    bodies : boxes
    pitch : m, of the streets
    texels : rows and columns of the ground's map of levels, drawn within 3 dB; none: uniform ground
    levels : these levels instead, dB
    kind : ``rough`` walls of soil's kind, or ``metal`` ones on smooth ground
    radar, settings : other than the drawn ones
    """
    rng = np.random.default_rng([seed, 0x0B0D])
    side = int(np.ceil(np.sqrt(max(bodies, 1))))
    half = 0.5 * side * pitch
    eps = rng.uniform(3.0, 9.0, 2) - 1j * rng.uniform(0.1, 2.0, 2)
    wall = Material("wall", pec=True)
    soil = Material("soil", permittivity=complex(eps[1]))
    if kind == "rough":
        rough: dict[str, Any] = {"diffuse_law": "lambert", "rms_height": 0.003}
        wall = Material("wall", permittivity=complex(eps[0]), diffuse_level_db=-12.0, **rough)
        soil = Material("soil", permittivity=complex(eps[1]), diffuse_level_db=-14.0, **rough)
    if levels is None and texels[0]:
        levels = rng.uniform(-3.0, 3.0, texels)
    if levels is not None:
        level = Bitmap(10.0 ** (0.1 * levels), place_in_plan((-half, -half, half, half)), smooth=True)
        soil = Material(
            "soil",
            permittivity=soil.permittivity,
            diffuse_law="lambert",
            diffuse_level_db=-14.0,
            rms_height=0.02,
            maps=SurfaceMaps(level=level),
        )
    meshes = [SceneMesh(*_box(rng, k, side, pitch), wall, f"house{k}") for k in range(bodies)]
    rim = 1.1 * half
    flat = np.array([[-rim, -rim, 0.0], [rim, -rim, 0.0], [rim, rim, 0.0], [-rim, rim, 0.0]])
    meshes.append(SceneMesh(flat, np.array([[0, 1, 2], [0, 2, 3]]), soil, "ground"))
    given: dict[str, Any] = {
        "slant_range": float(rng.uniform(2000.0, 6000.0)),
        "look_angle_deg": float(rng.uniform(30.0, 50.0)),
        "center_frequency": 9.65e9,
        "bandwidth": 150e6,
        "n_pulses": 6,
        "noise_temperature": 0.0,
        "mode": "spotlight",
    }
    chosen: dict[str, Any] = {
        "method": "hybrid",
        "key_pulse_interval": 6,
        "max_depth": 3,
        "effects": {"diffuse_pairs": "off", "edge_diffraction": "off"},
    }
    film = FilmDescription(image_extent_azimuth=2.0 * half, image_extent_range=2.0 * half)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return build_scene(
            meshes,
            radar=RadarDescription(**(given | (radar or {}))),
            film=film,
            settings=TraceSettings(**(chosen | (settings or {}))),
            name=f"city{seed}",
        )


def _box(rng: np.random.Generator, number: int, side: int, pitch: float) -> tuple[F64, np.ndarray]:
    """Vertices and faces of a box on its plot, turned about the vertical."""
    size = rng.uniform([0.3, 0.3, 0.25], [0.6, 0.6, 0.7]) * pitch
    v = (np.array(CORNERS, dtype=np.float64) - [0.5, 0.5, 0.0]) * size
    if number % 3 == 1:  # a sloping roof, which turns with the height
        v[(v[:, 0] < 0.0) & (v[:, 2] > 0.0), 2] *= 0.7
    turn = rng.uniform(0.0, np.pi)
    c, s = np.cos(turn), np.sin(turn)
    row, column = divmod(number, side)
    place = (np.array([column, row]) - 0.5 * (side - 1)) * pitch
    return v @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [*place, 0.0], FACES


def adjoint_of(rng: np.random.Generator, data: C64) -> C64:
    """Adjoint data, drawn, of the size of the data."""
    size = float(np.sqrt(np.mean(np.abs(data) ** 2)))
    noise = rng.standard_normal(data.shape) + 1j * rng.standard_normal(data.shape)
    return (data + size * noise).astype(np.complex64)


def products(adjoint: C64, planes: C64) -> tuple[F64, F64]:
    """Real part of the sum of conj(adjoint) times each plane, and the products of their norms."""
    own = adjoint.astype(np.complex128)
    found = np.array([np.vdot(own, p.astype(np.complex128)).real for p in planes])
    return found, np.array([np.linalg.norm(own) * np.linalg.norm(p) for p in planes])
