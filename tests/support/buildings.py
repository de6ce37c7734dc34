"""Drawn buildings on rough ground, seen from several looks."""

from __future__ import annotations

import warnings

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
from sarmitsuba.arrays import F64
from sarmitsuba.mesh.tessellate import cube

# distance of the middles of neighbouring plots, m
PLOT = 18.0
# (heading, look angle, squint angle) of the looks, degrees
LOOKS = ((0.0, 38.0), (65.0, 48.0))


def building(rng: np.random.Generator, place: F64, height: float) -> tuple[F64, F64]:
    """Vertices and faces of a box of drawn footprint and heading, whose feet are on the ground."""
    v, f = cube()
    size = rng.uniform(6.0, 10.0, 2)
    turn = rng.uniform(0.0, np.pi)
    v = (0.5 * v + [0.0, 0.0, 0.5]) * [*size, height]
    c, s = np.cos(turn), np.sin(turn)
    return v @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [*place, 0.0], f


def names(count: int) -> list[str]:
    """Names of the buildings."""
    return [f"building{k}" for k in range(count)]


def heights(seed: int, count: int) -> F64:
    """True heights, m."""
    return np.random.default_rng([seed, 0xB1]).uniform(5.0, 12.0, count)


def town(
    seed: int,
    count: int,
    of_heights: F64,
    look: int,
    noise_temperature: float = 0.0,
    speckle: int = 0,
    **more,
) -> Scene:
    """Boxes of rough concrete and rough metal on a grid of plots, on rough soil, as one look sees them.

    Parameters
    ----------
    seed : of footprints, places, headings and materials
    of_heights : (count,) m
    look : number of the look
    speckle : seed of the diffuse scatterers
    """
    rng = np.random.default_rng([seed, 0xB0])
    columns = int(np.ceil(np.sqrt(count)))
    rows = -(-count // columns)
    soil = Material(
        "soil", permittivity=8.0 - 1.0j, rms_height=0.01, diffuse_law="lambert", diffuse_level_db=-17.0
    )
    concrete = Material(
        "concrete", permittivity=5.3 - 0.3j, rms_height=0.004, diffuse_law="lambert", diffuse_level_db=-11.0
    )
    metal = Material("metal", pec=True, rms_height=0.004, diffuse_law="lambert", diffuse_level_db=-9.0)
    meshes = []
    for k, name in enumerate(names(count)):
        plot = (np.array([k % columns, k // columns]) - [0.5 * (columns - 1), 0.5 * (rows - 1)]) * PLOT
        place = plot + rng.uniform(-1.5, 1.5, 2)
        v, f = building(rng, place, float(of_heights[k]))
        meshes.append(SceneMesh(v, f, metal if rng.uniform() < 0.4 else concrete, name))
    wide, deep = 0.5 * PLOT * columns + 14.0, 0.5 * PLOT * rows + 14.0
    flat = np.array([[-wide, -deep, 0.0], [wide, -deep, 0.0], [wide, deep, 0.0], [-wide, deep, 0.0]])
    meshes.append(SceneMesh(flat, np.array([[0, 1, 2], [0, 2, 3]]), soil, "ground"))
    heading, look_angle = LOOKS[look]
    extent = PLOT * max(columns, rows) + 10.0
    radar = (
        dict(
            slant_range=5000.0,
            look_angle_deg=look_angle,
            heading_deg=heading,
            center_frequency=9.65e9,
            bandwidth=200e6,
            azimuth_resolution=1.0,
            aim_x=0.0,
            aim_y=0.0,
            aim_z=0.0,
            mode="spotlight",
            noise_temperature=noise_temperature,
        )
        | more
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return build_scene(
            meshes,
            radar=RadarDescription(**radar),
            film=FilmDescription(image_extent_azimuth=extent, image_extent_range=extent),
            settings=TraceSettings(
                method="hybrid",
                gridding_width=6,
                max_depth=2,
                seed=speckle,
                effects={"diffuse_pairs": "off", "edge_diffraction": "off"},
            ),
            name=f"town{seed}look{look}",
        )
