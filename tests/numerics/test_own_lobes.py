"""Scatterers of one's own with lobes narrower than a block of pulses: hybrid against tracing every pulse."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from sarmitsuba import PointTarget, RadarDescription, Scene, SceneMesh, build_scene, simulate
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.parameters import Param
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.scatterers import SCATTERERS, ScattererTarget
from sarmitsuba.tracing.scatterers.reflectors.reflector import LocalWaves, Reflector

GROUND = np.array([[-30.0, -30.0, 0.0], [30.0, -30.0, 0.0], [30.0, 30.0, 0.0], [-30.0, 30.0, 0.0]])
FACES = [[0, 1, 2], [0, 2, 3]]

pytestmark = pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # effects switched off


class Beacon(Reflector):
    """Lobe about the local z axis, Gaussian or with a sharp edge, and a phase centre in front of its position."""

    name = "beacon"
    parameters = (
        Param("width_deg", "float", 1.0, "of the lobe", "deg", 1e-4, 90.0),
        Param("sharp", "float", 0.0, "1: sharp edge", "", 0.0, 1.0),
    )

    def amplitude(self, waves: LocalWaves) -> mi.Complex2f:
        off = dr.norm(dr.cross(waves.transmitter, mi.Vector3f(0.0, 0.0, 1.0)))
        x = off / dr.sin(waves.values["width_deg"] * (math.pi / 180.0))
        lobe = dr.select(waves.values["sharp"] > 0.5, dr.select(x < 1.0, 1.0, 0.0), dr.exp(-dr.square(x)))
        return waves.co_polar * (10.0 * lobe)


@pytest.fixture(autouse=True)
def beacon() -> Iterator[None]:
    """The kind is known during the test."""
    SCATTERERS.register(Beacon())
    yield
    del SCATTERERS._entries["beacon"]


def axes_towards(z: F64) -> F64:
    """Right-handed axes with z along a vector."""
    z = z / np.linalg.norm(z)
    x = np.cross([0.3, -0.5, 0.8], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def scene_of(seed: int, *, ground: bool) -> Scene:
    """Beacons of drawn widths that shine at drawn pulses, at a drawn heading."""
    rng = np.random.default_rng(seed)
    radar = RadarDescription(
        slant_range=3e3,
        heading_deg=float(rng.uniform(0.0, 360.0)),
        look_angle_deg=float(rng.uniform(25.0, 55.0)),
        squint_angle_deg=float(rng.uniform(-5.0, 5.0)),
        bandwidth=60e6,
        azimuth_resolution=1.0,
        polarisation="HH,VV",
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    film = FilmDescription(image_extent_azimuth=16.0, image_extent_range=24.0)
    shapes = [SceneMesh(GROUND, FACES, "concrete", "ground")] if ground else []
    position = build_scene(
        [], [PointTarget("any", np.zeros(3), 1.0)], radar=radar, film=film
    ).radar.track.position
    turn = np.degrees(np.linalg.norm(position[-1] - position[0])) / 3e3
    targets = []
    for i in range(3):
        place = rng.uniform([-6.0, -6.0, 1.0], [6.0, 6.0, 3.0])
        to = position[rng.integers(len(position))] - place
        if ground and i == 2:
            to = to * [1.0, 1.0, -1.0]  # shines at the ground: a double bounce
        values = {"width_deg": float(turn * 10.0 ** rng.uniform(-2.5, 0.5)), "sharp": float(i == 1)}
        targets.append(ScattererTarget(f"beacon {i}", "beacon", place, axes_towards(to), values))
    return build_scene(shapes, radar=radar, film=film, scatterers=targets)


@pytest.mark.parametrize(("seed", "ground"), [(1, False), (2, True)])
def test_lobes_narrower_than_a_block(seed: int, ground: bool) -> None:
    scene = scene_of(seed, ground=ground)
    off = {"coherent": "off", "diffuse": "off"} if ground else {}
    scene = scene.replace(max_depth=3 if ground else 1, **off)
    blocks, pulses = (simulate(scene.replace(method=m), seed=1) for m in ("hybrid", "raw"))
    assert blocks.metadata["effects"]["effects"]["key_pulse_interval"]["value"] > 8  # pulses of a block
    for channel in ("HH", "VV"):
        one, other = blocks.total(channel), pulses.total(channel)
        change = np.linalg.norm(one - other) / np.linalg.norm(other)
        assert change < 10 ** (-40 / 20)  # tol: the tolerance of blocks
