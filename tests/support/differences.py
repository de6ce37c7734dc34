"""Drawn scenes of boxes on ground, and derivatives of their raw data by central differences of whole runs."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT

# steps of the differences by unit: a sixth of a radian of phase, and a hundredth of a material's property
METRES, SECONDS, DECIBELS, SHARE, LOSS, RADIANS = 4e-4, 2e-11, 0.05, 0.02, 0.04, 5e-5

# wavelength of these steps, m
AT_WAVELENGTH = SPEED_OF_LIGHT / 9.65e9

# drawn sets of channels
CHANNELS = ("HH", "VV", "HH,HV,VH,VV")

# kinds of scenes with automatic blocks of pulses
AUTOMATIC = ("alone", "house")

# step of the differences of the beam's angles, in half-widths
BEAM = 0.05

# relative difference of differences of fourth and sixth order up to which the data are smooth over the steps
SMOOTH = 2e-4


def box(rng: np.random.Generator, turn: float) -> tuple[F64, F64]:
    """Vertices and faces of a box that stands on the ground, turned about the vertical."""
    size, place = rng.uniform([3.0, 3.0, 2.0], [7.0, 7.0, 6.0]), rng.uniform(-3.0, 3.0, 2)
    v = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=np.float64)
    v = (v - [0.5, 0.5, 0.0]) * size
    c, s = np.cos(turn), np.sin(turn)
    v = v @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [*place, 0.0]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [triangle for a, b, c_, d in quads for triangle in ((a, b, c_), (a, c_, d))]
    return v, np.array(faces)


def house(rng: np.random.Generator, turn: float) -> tuple[F64, F64]:
    """The same with a ridge over the middle instead of a flat roof."""
    v, faces = box(rng, turn)
    ends = 0.5 * (v[[4, 5]] + v[[6, 7]]) + [0.0, 0.0, rng.uniform(1.0, 3.0)]
    roof = [(4, 5, 9), (4, 9, 8), (6, 9, 7), (6, 8, 9), (4, 8, 6), (5, 7, 9)]
    return np.concatenate([v, ends]), np.concatenate([np.delete(faces, [2, 3], axis=0), roof])


def drawn(seed: int, kind: str, pulses: int = 6) -> Scene:
    """A box on ground under a squinted radar.

    Parameters
    ----------
    pulses : all in one block; ``alone`` and ``house`` have about 37, in automatic blocks
    kind : ``rough``: both scatter diffusely, with mirrors; ``metal``: metal on smooth ground, with mirrors; ``alone``:
        a rough box whose ground returns nothing to the radar, without mirrors: nothing that a moving box could shadow;
        ``house``: the same with a roof, at a drawn heading, in drawn channels, in spotlight or stripmap mode;
        ``beam``: as ``rough``, in a beam as wide as the scene
    """
    rng = np.random.default_rng([seed, 0x6A61C])
    eps = rng.uniform(3.0, 9.0, 2) - 1j * rng.uniform(0.1, 2.0, 2)
    heights, lengths = rng.uniform(0.001, 0.003, 2), rng.uniform(0.02, 0.06, 2)
    wall = Material(
        "wall",
        permittivity=complex(eps[0]),
        rms_height=float(heights[0]),
        diffuse_law="small_perturbation",
        correlation_length=float(lengths[0]),
    )
    soil = Material("soil", permittivity=complex(eps[1]))
    if kind == "metal":
        wall = Material("wall", pec=True)
    elif kind in ("rough", "beam"):
        soil = Material(
            "soil",
            permittivity=complex(eps[1]),
            rms_height=float(heights[1]),
            diffuse_law="lambert",
            diffuse_level_db=float(rng.uniform(-20.0, -5.0)),
        )
    radar = RadarDescription(
        slant_range=float(rng.uniform(2000.0, 6000.0)),
        look_angle_deg=float(rng.uniform(25.0, 55.0)),
        center_frequency=9.65e9,
        bandwidth=150e6,
        n_pulses=pulses,
        noise_temperature=0.0,
        mode="spotlight",
        squint_angle_deg=float(rng.uniform(8.0, 20.0)),
    )
    if kind == "house":
        radar = replace(
            radar,
            heading_deg=float(rng.uniform(0.0, 360.0)),
            polarisation=str(rng.choice(CHANNELS)),
            mode=str(rng.choice(["spotlight", "stripmap"])),
        )
    if kind == "beam":
        width = np.degrees(rng.uniform(0.4, 1.2, 2) * 22.0 / radar.slant_range)
        radar = replace(
            radar,
            pattern=str(rng.choice(["gaussian", "rectangular"])),
            azimuth_beamwidth_deg=float(width[0]),
            elevation_beamwidth_deg=float(width[1]),
        )
    if kind in AUTOMATIC:
        radar = replace(radar, n_pulses=0, azimuth_resolution=1.3)
    settings = TraceSettings(
        method="hybrid",
        key_pulse_interval=0 if kind in AUTOMATIC else pulses,
        gridding_width=8,
        max_depth=1 if kind in AUTOMATIC else 4,
        effects={"diffuse_pairs": "off", "edge_diffraction": "off"},
    )
    size = 25.0
    flat = np.array([[-size, -size, 0.0], [size, -size, 0.0], [size, size, 0.0], [-size, size, 0.0]])
    meshes = [
        SceneMesh(*(house if kind == "house" else box)(rng, float(rng.uniform(0.0, np.pi))), wall, "box"),
        SceneMesh(flat, np.array([[0, 1, 2], [0, 2, 3]]), soil, "ground"),
    ]
    film = FilmDescription(image_extent_azimuth=22.0, image_extent_range=22.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return build_scene(meshes, radar=radar, film=film, settings=settings, name=f"{kind}{seed}")


# kinds of parameters whose derivatives are exact for the paths found, with the drawn scenes to show it
EXACT = (
    ("alone", "shift:box:x,shift:box:y,shift:box:z"),
    ("alone", "height:box"),
    ("alone", "scale:box"),
    ("alone", "rotation:box"),
    ("house", "height:box"),
    ("house", "rotation:box"),
    ("metal", "track:2"),
    ("metal", "permittivity:soil"),
    ("beam", "pointing"),
    ("rough", "gain"),
    ("rough", "clock_offset"),
    ("rough", "track:2"),
    ("rough", "level:soil"),
    ("rough", "permittivity:wall"),
    ("rough", "permittivity:soil"),
    ("rough", "loss:wall"),
    ("rough", "rms_height:wall"),
    ("rough", "rms_height:soil"),
    ("rough", "correlation_length:wall"),
)


@dataclass(frozen=True, eq=False)
class Compared:
    """Derivative along one direction of the values against central differences of sixth order.

    Parameters
    ----------
    error : of the derivative, relative to the norm of the differences
    steady : whether equally many rays hit and echo at all values, and differences of two orders agree: no echo
        appeared or vanished
    """

    error: float
    steady: bool


def compared(scene: Scene, kind: str, seed: int = 0) -> Compared:
    """Compare the derivatives of one kind of parameter, along a drawn direction if it has several values."""
    return compared_all(scene, (kind,), seed)[0]


def compared_all(scene: Scene, kinds: Sequence[str], seed: int = 0) -> list[Compared]:
    """The same for several kinds of parameters, whose derivatives one kernel carries."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = ForwardModel(scene, parse(",".join(kinds), scene))
        _, derivative = model.derivative()
    rng, found, first = np.random.default_rng([seed, 7]), [], 0
    for kind in kinds:
        n = sum(len(p.values(scene)) for p in parse(kind, scene))
        way = np.zeros(len(model.names))
        way[first : first + n] = rng.standard_normal(n) if n > 1 else 1.0
        way /= np.linalg.norm(way)
        h = step(model, first)
        counts = set()
        data: list[C128] = []
        for steps in (1.0, -1.0, 2.0, -2.0, 3.0, -3.0):
            data.append(model.data(model.start + steps * h * way).astype(np.complex128))
            counts.add((model.statistics.hits, model.statistics.contributions))
        own = np.einsum("k,kcps->cps", way.astype(np.complex128), derivative.astype(np.complex128))
        one, two, three = (data[2 * i] - data[2 * i + 1] for i in range(3))
        fourth, expected = (8.0 * one - two) / (12.0 * h), (45.0 * one - 9.0 * two + three) / (60.0 * h)
        smooth = relative(fourth, expected) < SMOOTH
        found.append(Compared(relative(own, expected), smooth and len(counts) == 1))
        first += n
    return found


def step(model: ForwardModel, number: int) -> float:
    """Step of the differences of a value of a model: lengths that turn phases by a share of the wavelength."""
    name, value = model.names[number], float(model.start[number])
    length = METRES * model.scene.radar.waveform.wavelength / AT_WAVELENGTH
    kind, unit = name.split(":")[0], name.rsplit("[", 1)[1].rstrip("]")
    if kind == "loss":
        return LOSS
    if kind.startswith("pointing"):
        return BEAM / model.scene.radar.antenna.per_width[0]
    if kind == "thickness":
        return length / 8.0
    if kind in ("permittivity", "rms_height", "correlation_length"):
        return SHARE * value
    return {"m": length, "s": SECONDS, "dB": DECIBELS, "rad": RADIANS * length / METRES, "1": length / 4.0}[
        unit
    ]


def relative(found: C64 | C128, expected: C128) -> float:
    """Norm of the difference over that of what is expected."""
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))
