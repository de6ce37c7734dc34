"""Ideal points that lie on surfaces: seen wherever the facet itself is, hidden behind everything else."""

from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.points import PointLegs
from sarmitsuba.tracing.kernel.scene_tables import TraceScene, build_trace_scene
from tests.support.unweighted import focus

WAVELENGTH = 0.03
SCENE = """<scene version="3.0.0">
  <integrator type="sar_path"><integer name="max_depth" value="1"/></integrator>
  <sensor type="sar_antenna" id="radar">
    <float name="slant_range" value="5000"/><float name="azimuth_resolution" value="1"/>
    <string name="mode" value="spotlight"/>
    <film type="range_film">
      <float name="image_extent_azimuth" value="40"/><float name="image_extent_range" value="40"/>
    </film>
  </sensor>
  <bsdf type="radar_material" id="metal"><string name="material" value="pec"/></bsdf>
  {shapes}
</scene>
"""


def scene_of(vertices: np.ndarray, faces: np.ndarray) -> TraceScene:
    ensure_backend()
    geometry = Geometry(
        np.asarray(vertices, dtype=np.float64),
        np.asarray(faces, dtype=np.int32),
        np.zeros(len(faces), dtype=np.int32),
        np.zeros(len(faces), dtype=np.int32),
        ("body",),
        np.array([0, len(faces)]),
    )
    return build_trace_scene(geometry, (Material("metal", pec=True),), WAVELENGTH)


def seen(scene: TraceScene, point: np.ndarray, towards: np.ndarray, distance: float = 5e3) -> np.ndarray:
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    position = np.broadcast_to(point, towards.shape)
    antenna = position + towards * distance
    return PointLegs.of(scene, KernelFlags(), WAVELENGTH, position, antenna, (0.0, 0.0, 1.0)).seen


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    corner = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corner, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


@pytest.mark.parametrize("offset", [0.0, 400.0])
def test_random_points_on_random_facets_are_seen_at_any_angle(offset: float) -> None:
    # rationale: a facet cannot hide what lies on it, and a convex body hides nothing else of its lit side
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    vertices, faces = box((-20.0, -10.0, -7.0), (20.0, 10.0, 7.0))
    vertices = vertices @ turn.T + offset
    scene = scene_of(vertices, faces)
    for _ in range(60):
        a, b, c = vertices[rng.choice(faces)]
        u, v = np.sort(rng.random(2))
        point = a + (b - a) * u + (c - b) * v * u
        normal = np.cross(b - a, c - a)
        normal *= np.sign(normal @ (a - vertices.mean(axis=0))) / np.linalg.norm(normal)
        tangent = np.cross(normal, rng.normal(size=3))
        tangent /= np.linalg.norm(tangent)
        grazing = np.radians(np.array([0.05, 0.3, 2.0, 20.0, 70.0, 90.0]))[:, None]
        towards = np.cos(grazing) * tangent + np.sin(grazing) * normal
        assert seen(scene, point, towards).all()
        # below the horizon the whole body stands between
        assert not seen(scene, point, np.cos(grazing) * tangent - np.sin(grazing) * normal)[1:].any()


def test_points_just_below_a_roof_and_behind_walls_are_hidden() -> None:
    scene = scene_of(*box((-5.0, -5.0, 0.0), (5.0, 5.0, 8.0)))
    up = np.array([[0.6, 0.0, 0.8], [0.9, 0.3, 0.1]])
    assert seen(scene, np.array([1.0, 2.0, 8.0]), up).all()
    assert not seen(scene, np.array([1.0, 2.0, 7.99]), up).any()
    assert not seen(scene, np.array([-6.0, 0.0, 1.0]), up[1:]).any()
    # on the wall turned away, and at its foot
    assert not seen(scene, np.array([-5.0, 0.0, 3.0]), up).any()
    assert not seen(scene, np.array([-5.0, 0.0, 0.0]), up).any()
    # on the rim of the roof and at a corner of it, each face's normal another way
    assert seen(scene, np.array([5.0, 1.0, 8.0]), up).all()
    assert seen(scene, np.array([5.0, 5.0, 8.0]), up).all()


def test_points_on_flat_ground_keep_their_cross_section(tmp_path: Path) -> None:
    # rationale: 20 dBsm on ground that returns nothing itself (a smooth mirror, seen slantwise)
    rng = np.random.default_rng(9)
    shapes = '<shape type="rectangle" id="ground"><ref id="metal"/>' + (
        '<transform name="to_world"><scale value="40"/></transform></shape>'
    )
    x, y = rng.uniform(-15.0, 15.0, 2)
    shapes += (
        f'<shape type="sphere" id="point"><point name="center" x="{x}" y="{y}" z="0"/>'
        '<float name="radius" value="0.1"/>'
        '<bsdf type="point_scatterer"><float name="rcs_dbsm" value="20"/></bsdf></shape>'
    )
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(shapes=shapes))
    raw = sarmitsuba.simulate(sarmitsuba.load_scene(path))
    request = ImageRequest("ground", x, y, 0.0, 4.0, 4.0, 0.1, 0.1)
    image = focus(raw, request=request)
    # tol: the ground's rim and side lobes
    assert abs(20.0 * np.log10(np.abs(image.total("VV")).max()) - 20.0) < 0.2
