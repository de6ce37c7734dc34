"""Drawn buildings on rough ground under several looks, and fits of their heights."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba import (
    FilmDescription,
    Fit,
    Material,
    RadarDescription,
    RawData,
    Scene,
    SceneMesh,
    TraceSettings,
    build_scene,
    fit,
)
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.jacobian import parameters_of
from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.scene.mesh.tessellate import cube
from tests.support.fits import noisy

# distance of the middles of neighbouring plots, and width of the ground around them, m
PLOT, MARGIN = 18.0, 14.0
# heading and look angle of the looks, degrees
LOOKS = ((0.0, 38.0), (65.0, 48.0))


def building(rng: np.random.Generator, place: F64, height: float) -> tuple[F64, I32]:
    """Vertices and faces of a box of drawn footprint and heading, whose feet are on the ground."""
    v, f = cube()
    size, turn = rng.uniform(6.0, 10.0, 2), rng.uniform(0.0, np.pi)
    v = (0.5 * v + [0.0, 0.0, 0.5]) * [*size, height]
    c, s = np.cos(turn), np.sin(turn)
    return v @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [*place, 0.0], f


def names(count: int) -> list[str]:
    """Names of the buildings."""
    return [f"building{k}" for k in range(count)]


def town(
    seed: int,
    heights: F64,
    look: int,
    speckle: int = 0,
    left_out: Sequence[str] = (),
    ray_spacing: float = 0.0,
    **radar: object,
) -> Scene:
    """Boxes of rough concrete and rough metal on plots of rough soil, as one look sees them.

    Parameters
    ----------
    seed : of footprints, places, headings and materials
    heights : of the buildings, m
    look : number of the look
    speckle : seed of the diffuse scatterers
    left_out : names of buildings that are not there
    ray_spacing : m, of all rays; 0: automatic
    radar : values in place of the look's; None: none
    """
    rng, count = np.random.default_rng([seed, 0xB0]), len(heights)
    columns = int(np.ceil(np.sqrt(count)))
    rows = -(-count // columns)

    def rough(name: str, level: float, **more: object) -> Material:
        given = {"rms_height": 0.004, "diffuse_law": "lambert", "diffuse_level_db": level} | more
        return Material(name, **given)  # type: ignore[arg-type]

    soil = rough("soil", -17.0, permittivity=8.0 - 1.0j, rms_height=0.01)
    walls = (rough("concrete", -11.0, permittivity=5.3 - 0.3j), rough("metal", -9.0, pec=True))
    meshes = []
    for k, name in enumerate(names(count)):
        plot = np.array([k % columns, k // columns]) - [0.5 * (columns - 1), 0.5 * (rows - 1)]
        box = building(rng, PLOT * plot + rng.uniform(-1.5, 1.5, 2), float(heights[k]))
        meshes.append(SceneMesh(*box, walls[int(rng.uniform() < 0.4)], name))
    wide, deep = 0.5 * PLOT * columns + MARGIN, 0.5 * PLOT * rows + MARGIN
    meshes = [mesh for mesh in meshes if mesh.name not in left_out]
    flat = np.array([[-wide, -deep, 0.0], [wide, -deep, 0.0], [wide, deep, 0.0], [-wide, deep, 0.0]])
    meshes.append(SceneMesh(flat, np.array([[0, 1, 2], [0, 2, 3]]), soil, "ground"))
    heading, look_angle = LOOKS[look]
    extent = PLOT * columns + 10.0
    given = {
        "mode": "spotlight",
        "slant_range": 5000.0,
        "look_angle_deg": look_angle,
        "heading_deg": heading,
        "aim_x": 0.0,
        "aim_y": 0.0,
        "aim_z": 0.0,
        "center_frequency": 9.65e9,
        "bandwidth": 200e6,
        "azimuth_resolution": 1.0,
        "noise_temperature": 0.0,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return build_scene(
            meshes,
            radar=RadarDescription(**{k: v for k, v in (given | radar).items() if v is not None}),  # type: ignore[arg-type]
            film=FilmDescription(image_extent_azimuth=extent, image_extent_range=extent),
            settings=TraceSettings(
                method="hybrid",
                ray_spacing=ray_spacing,
                gridding_width=6,
                max_depth=2,
                seed=speckle,
                effects={"diffuse_pairs": "off", "edge_diffraction": "off"},
            ),
            name=f"town{seed}look{look}",
        )


@dataclass(frozen=True, eq=False)
class Drawn:
    """Scenes of all looks with wrong values, raw data of the true ones with noise, and the true values."""

    scenes: tuple[Scene, ...]
    data: tuple[RawData, ...]
    parameters: str
    truth: F64

    def fitted(self, **options: object) -> Fit:
        """Fit to the data."""
        return fit(self.scenes, self.data, self.parameters, **options)  # type: ignore[arg-type]


def drawn_town(
    seed: int,
    count: int,
    looks: Sequence[int] = (0, 1),
    wrong: float = 3.0,
    kinds: Sequence[str] = ("height:@",),
    *,
    snr_db: float = 20.0,
    speckle: int = 0,
) -> Drawn:
    """A drawn town whose values start off by up to ``wrong``, m, with data of a mean signal over noise.

    Parameters
    ----------
    kinds : parameters of every building, whose name stands for ``@``
    speckle : seed of the scatterers that the data are of; the scenes' is 0
    """
    heights = np.random.default_rng([seed, 0xB1]).uniform(5.0, 12.0, count)
    parameters = ",".join(kind.replace("@", name) for name in names(count) for kind in kinds)
    offsets = np.random.default_rng([seed, 0xB2]).uniform(-wrong, wrong, count * len(kinds))
    scenes, data = [], []
    truth = np.zeros(len(offsets))
    for look in looks:
        scene, real = town(seed, heights, look), town(seed, heights, look, speckle)
        model = ForwardModel(real, parameters_of(parameters, real))
        truth = model.start + offsets
        raw = model.raw(model.data(truth))
        # real data have no record of their scatterers
        raw = replace(raw, metadata={}) if speckle else raw
        noise, temperature = noisy(raw, snr_db, 100 * seed + look)
        scenes.append(replace(scene, radar=replace(scene.radar, noise_temperature=temperature)))
        data.append(noise)
    return Drawn(tuple(scenes), tuple(data), parameters, truth)
