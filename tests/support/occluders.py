"""Drawn walls on ground behind a body that returns nothing but hides them, and derivatives by its movement.

The reference shares nothing with the rays beside edges: means over ray lattices of whole runs with the body moved.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

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
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import At, parse
from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.tracing.derivatives.tangents import Displacement
from tests.support.differences import relative

# m: steps over which what is hidden of a wall changes evenly, and its phase along the wall by little
UPWARDS, SIDEWAYS = 0.1, 0.04
STEPS = {"height": UPWARDS, "shift": UPWARDS, "scale": 0.02, "rotation": 0.02}

RADAR = RadarDescription(
    slant_range=3000.0,
    center_frequency=9.65e9,
    bandwidth=150e6,
    noise_temperature=0.0,
    mode="spotlight",
    polarisation="VV",
)
# of a box of 1 m
CORNERS = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=np.float64)


def hidden_wall(
    seed: int,
    *,
    method: Literal["hybrid", "raw"] = "hybrid",
    polarisation: str = "VV",
    pulses: int = 4,
    rough: bool = False,
) -> Scene:
    """A metal wall that faces the radar, smooth or slightly rough ground before it, and a body there.

    The body is a turned box that returns nothing (its permittivity is 1, its roughness leaves no mirror): it hides
    parts of the ground and the wall on all three legs of their double bounces.
    """
    rng = np.random.default_rng([seed, 0xED6E])
    soil = Material("soil", permittivity=complex(rng.uniform(3.0, 9.0)))
    if rough:
        soil = Material(
            "soil", permittivity=5.0, rms_height=5e-4, diffuse_law="lambert", diffuse_level_db=-25.0
        )
    radar = replace(
        RADAR,
        look_angle_deg=float(rng.uniform(40.0, 60.0)),
        n_pulses=pulses,
        polarisation=polarisation,
    )
    c, s = np.cos(turn := float(rng.uniform(0.3, 1.2))), np.sin(turn)
    body = (CORNERS - [0.5, 0.5, 0.0]) * [1.5, 2.2, 2.6]
    body = body @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    body += [rng.uniform(3.0, 4.5), rng.uniform(-2.0, 2.0), 0.0]
    return _before_wall(f"hidden{seed}", radar, method, soil, body)


def half_hidden_corner(place: float, *, beyond: bool) -> tuple[Scene, float]:
    """A metal wall on metal ground, half of it behind a tall screen that returns nothing; one pulse.

    Parameters
    ----------
    place : m, across the line of sight from the middle of the wall, of the screen's edge
    beyond : whether the screen is on the positive side of it

    Returns
    -------
    scene, sign : 1 where a shift of the screen by its y moves the edge to the positive side, else -1
    """
    radar = replace(RADAR, look_angle_deg=50.0, n_pulses=1)
    body = (CORNERS - [0.0, 0.0 if beyond else 1.0, 0.0]) * [0.5, 12.0, 9.0] + [3.0, place, 0.0]
    scene = _before_wall("half hidden", radar, "raw", Material("soil", pec=True), body)
    return scene, float(np.sign(scene.radar.track.center_position[0]))


def _before_wall(
    name: str, radar: RadarDescription, method: Literal["hybrid", "raw"], soil: Material, body: F64
) -> Scene:
    """Metal wall, 6 m wide and 5 m high, that faces the radar, ground, and a box (8, 3) before it.

    Its corners, m, are towards the radar, across, and upwards.
    """
    metal, black = Material("wall", pec=True), Material("black", permittivity=1.0, rms_height=0.5)
    settings = TraceSettings(
        method=method,
        gridding_width=8,
        max_depth=3,
        effects={"diffuse_pairs": "off", "edge_diffraction": "off"},
        key_pulse_interval=radar.n_pulses if method == "hybrid" else 0,
    )
    size = 25.0
    flat = np.array([[-size, -size, 0.0], [size, -size, 0.0], [size, size, 0.0], [-size, size, 0.0]])
    ground = SceneMesh(flat, np.array([[0, 1, 2], [0, 2, 3]]), soil, "ground")
    film = FilmDescription(image_extent_azimuth=30.0, image_extent_range=30.0)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plain = build_scene([ground], radar=radar, film=film, settings=settings, name="plain")
        towards = plain.radar.track.center_position * [1.0, 1.0, 0.0]
        towards /= np.linalg.norm(towards)
        axes = np.stack([towards, [-towards[1], towards[0], 0.0], [0.0, 0.0, 1.0]])
        meshes = [
            ground,
            SceneMesh((CORNERS - [1.0, 0.5, 0.0]) * [1.0, 6.0, 5.0] @ axes, faces, metal, "wall"),
            SceneMesh(body @ axes, faces, black, "body"),
        ]
        return build_scene(meshes, radar=radar, film=film, settings=settings, name=name)


@dataclass(frozen=True, eq=False)
class EdgeShare:
    """Derivatives against differences of means over lattices: relative errors.

    Parameters
    ----------
    without, found : without the rays beside edges, and with them
    noise : of the reference, from its spread over the lattices
    """

    without: float
    found: float
    noise: float


def edge_share(scene: Scene, parameter: str, lattices: int, step: float | None = None) -> EdgeShare:
    """Compare the derivative by one parameter, in the mean over ray lattices."""
    model = EdgeModel.of(scene, parameter)
    h = STEPS[parameter.split(":")[0]] if step is None else step
    own, plain, differences = [], [], []
    for k in range(lattices):
        model.rays = model.run.rays(model.sampling, k)
        with_edges = model.derivative()[1][0].astype(np.complex128)
        own.append(with_edges)
        plain.append(with_edges - model.edges[0])
        up, down = (model.data(model.start + sign * h).astype(np.complex128) for sign in (1.0, -1.0))
        differences.append((up - down) / (2.0 * h))
    expected = _mean(differences)
    apart = np.array(differences) - np.array(own)
    spread = np.linalg.norm(apart - apart.mean(axis=0)) / lattices / np.linalg.norm(expected)
    return EdgeShare(relative(_mean(plain), expected), relative(_mean(own), expected), float(spread))


class EdgeModel(ForwardModel):
    """Model that keeps what edges added to the most recent derivatives, ``edges``."""

    edges: Sequence[C64] = ()

    @classmethod
    def of(cls, scene: Scene, parameter: str) -> EdgeModel:
        """Raw data of a scene as a function of one parameter."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # edge diffraction is off
            return cls(scene, parse(parameter, scene))

    def beside_edges(self, here: At, displacements: Sequence[Displacement]) -> Sequence[C64]:
        """See the base class."""
        self.edges = super().beside_edges(here, displacements)
        return self.edges


def displacements(model: ForwardModel) -> list[Displacement]:
    """Displacements of all parameters of a model."""
    here = model.placed()
    faces = here.scene.geometry.face_mesh[here.trace_scene.geometry_faces]
    return [d for p in model.parameters for d in p.displacements(here.scene, faces)]


def _mean(arrays: list[C128] | list[C64]) -> C128:
    return np.asarray(np.mean(arrays, axis=0), dtype=np.complex128)
