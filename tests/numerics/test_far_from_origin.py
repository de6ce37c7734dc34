"""Scenes in map coordinates, and scenes ten kilometres across."""

from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.scene.mesh.formats import write_ply
from sarmitsuba.tracing.kernel.launch import LaunchFrame, LaunchGrid, frame_towards, lattice
from sarmitsuba.truth.validation.targets import PEC, geometry, parallelogram
from tests.support.paths import coherent_flags, record_paths
from tests.support.unweighted import focus

FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY

SCENE = """<scene version="3.0.0">
  <integrator type="sar_path"><integer name="max_depth" value="2"/></integrator>
  <sensor type="sar_antenna">
    <float name="slant_range" value="5000"/>
    <float name="aim_x" value="{0!r}"/><float name="aim_y" value="{1!r}"/><float name="aim_z" value="{2!r}"/>
    <float name="center_frequency" value="9.65e9"/>
    <float name="azimuth_resolution" value="1"/><integer name="n_pulses" value="32"/>
    <string name="mode" value="spotlight"/>
    <film type="range_film">
      <float name="image_extent_azimuth" value="8"/><float name="image_extent_range" value="8"/>
    </film>
  </sensor>
  <bsdf type="radar_material" id="concrete">
    <string name="material" value="concrete"/><boolean name="smooth" value="true"/>
  </bsdf>
  {3}
</scene>
"""
FLOOR = parallelogram([-1.69, -1.13, 0.0], [2.3, 0.0, 0.0], [0.0, 2.3, 0.0])
WALL = parallelogram([0.61, -1.13, 0.0], [0.0, 2.3, 0.0], [0.0, 0.0, 1.7])


def corner_in_map_coordinates(
    folder: Path, offset: np.ndarray, way: str, *, rounded_at: np.ndarray | None = None
) -> np.ndarray:
    """Focused image of a wall on its floor with everything moved by ``offset``.

    ``rounded_at``: float32 has rounded the vertices at this place before.
    """
    shapes = []
    for name, (v, f) in (("floor", FLOOR), ("wall", WALL)):
        if rounded_at is not None:
            v = (v + rounded_at).astype(np.float32).astype(np.float64) - rounded_at
        placed = v + offset if way == "vertices" else v
        transform = ""
        if way == "to_world":
            x, y, z = offset
            transform = (
                f'<transform name="to_world"><translate x="{x!r}" y="{y!r}" z="{z!r}"/></transform>'.replace(
                    "np.float64(", ""
                ).replace(")", "")
            )
        write_ply(folder / f"{name}.ply", placed, f)
        shapes.append(
            f'<shape type="ply" id="{name}"><string name="filename" value="{name}.ply"/>{transform}'
            f'<ref id="concrete"/></shape>'
        )
    path = folder / "corner.xml"
    path.write_text(SCENE.format(*map(float, offset), "\n".join(shapes)))
    scene = sarmitsuba.load_scene(path)
    return focus(sarmitsuba.simulate(scene), request=scene.image).total()


@pytest.mark.parametrize("way", ["vertices", "to_world"])
def test_map_coordinates_change_nothing(row, tmp_path: Path, way: str) -> None:
    """Geometry at 1, 10 and 5300 km, in double-precision PLY or by to_world: the image of the centred scene.

    Naive way: coordinates in float32, as Mitsuba stores them: half a metre steps at 5300 km, the wall leans and shifts.
    """
    centred = corner_in_map_coordinates(tmp_path, np.zeros(3), way)
    peak = np.abs(centred).max()
    worst = 0.0
    for offset in ([1000.0, 0.0, 0.0], [1e4, -1e4, 250.0], [1e6, 5.3e6, 512.0]):
        moved = corner_in_map_coordinates(tmp_path, np.array(offset), way)
        worst = max(worst, float(np.abs(moved - centred).max() / peak))
    naive = None
    if way == "vertices":
        offset = np.array([1e6, 5.3e6, 512.0])
        wrong = corner_in_map_coordinates(tmp_path, np.zeros(3), way, rounded_at=offset)
        naive = float(np.abs(wrong - centred).max() / peak)
    row(
        f"scene at 1 to 5300 km from its origin, by {way}: largest change of the image over its peak",
        worst,
        1e-3,
        naive=naive,
        remedy="vertices and transforms in float64, re-centred by whole metres before float32",
    )


LOOK = np.array([1.0, 0.0, 1.2]) / np.linalg.norm([1.0, 0.0, 1.2])


def wall_at(center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wall of 2 m on the ground at ``center``."""
    return parallelogram(center - np.array([0.0, 1.0, 0.0]), [0.0, 2.0, 0.0], [0.0, 0.0, 2.0])


def echo(center: np.ndarray, ground: tuple[np.ndarray, np.ndarray]) -> complex:
    """Coherent sum of the paths of a 2 m corner at ``center`` on a given ground, lit in a 5 m window."""
    scene = geometry([ground, wall_at(center)])
    antenna = center + 1e5 * LOOK
    frame = frame_towards(antenna[None], center, np.array([0.0, 1.0, 0.0]))
    paths = record_paths(scene, PEC, antenna, frame, lattice(2.5, 2.5, WAVELENGTH / 2), FREQUENCY)
    seen = paths.seen
    phase = np.exp(-4j * np.pi / WAVELENGTH * (paths.slant_range[seen] - 1e5))
    return complex((paths.amplitude[seen] * phase).sum())


def rays_near(frame: LaunchFrame, grid: LaunchGrid, antenna: np.ndarray) -> tuple["mi.Ray3f", np.ndarray]:
    """Float32 rays of a launch from 10 m before its plane, and their float64 directions (n, 3)."""
    xy = np.stack([grid.x, grid.y], axis=1).astype(np.float64)
    start = frame.center[0] + xy @ np.stack([frame.axis_x[0], frame.axis_y[0]])
    d = start - antenna
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o, d32 = (np.ascontiguousarray(a.T.astype(np.float32)) for a in (start - 10.0 * d, d))
    return mi.Ray3f(mi.Point3f(o), mi.Vector3f(d32)), d


def second_bounces(scene: "mi.Scene", center: np.ndarray) -> int:
    """Rays of ``echo`` that bounce off both ground and wall where each starts by Mitsuba's own ``spawn_ray``."""
    antenna = center + 1e5 * LOOK
    frame = frame_towards(antenna[None], center, np.array([0.0, 1.0, 0.0]))
    ray, _ = rays_near(frame, lattice(2.5, 2.5, WAVELENGTH / 2), antenna)
    first = scene.ray_intersect(ray)
    mirrored = first.spawn_ray(ray.d - 2.0 * dr.dot(ray.d, first.n) * first.n)
    second = scene.ray_intersect(mirrored, active=first.is_valid())
    back = second.spawn_ray(mi.Vector3f(LOOK))
    return int((second.is_valid() & ~scene.ray_test(back, second.is_valid())).numpy().sum())


def test_scene_ten_kilometres_across(row, plain_scene) -> None:
    """A 2 m wall at the far corner of a 10 km plain returns what it returns alone.

    Naive ways: Mitsuba's own ray offset, 0.44 m there, lifts a tenth of the second bounces over the wall;
    lengths to where float32 rays land are degrees of phase apart from ray to ray. Plain Mitsuba stands for both. The
    double bounces of a corner return in phase, so that its echo falls with their number.
    """
    near = parallelogram([-8, -8, 0], [16, 0, 0], [0, 16, 0])
    alone = echo(np.zeros(3), near)
    plain = parallelogram([-5000, -5000, 0], [10_000, 0, 0], [0, 10_000, 0])
    corner = np.array([4900.0, -4900.0, 0.0])
    ours = float(abs(echo(corner, plain) - alone) / abs(alone))
    far_bounces = second_bounces(plain_scene(geometry([plain, wall_at(corner)])), corner)
    near_bounces = second_bounces(plain_scene(geometry([near, wall_at(np.zeros(3))])), np.zeros(3))
    naive = abs(far_bounces / near_bounces - 1.0)
    # tol: float32 of the tracing, 0.5 mm at 5 km, decides which rays pass the wall's edges
    row(
        "wall in a scene 10 km across: relative change of its echo",
        ours,
        1e-2,
        naive=naive,
        remedy="rays start 8 roundings of the scene's size off a facet, not 9e-5 of it",
    )

    antenna = corner + 1e5 * LOOK
    frame = frame_towards(antenna[None], corner, np.array([0.0, 1.0, 0.0]))
    grid = lattice(2.5, 2.5, 0.05)
    flags = coherent_flags(
        PEC, ("VV",), 1, tube_phase=False
    )  # inner tubes of a facet cancel, and return nothing
    paths = record_paths(geometry([plain]), PEC, antenna, frame, grid, FREQUENCY, max_depth=1, flags=flags)
    got = paths.slant_range[0]
    ray, d = rays_near(frame, grid, antenna)
    truth = -antenna[2] / d[:, 2]
    landed = plain_scene(geometry([plain])).ray_intersect(ray).p.numpy().T.astype(np.float64)

    def phase_noise(slant_range: np.ndarray) -> float:
        error = (slant_range - truth) * 4.0 * np.pi / WAVELENGTH
        return float(np.degrees(np.sqrt(np.mean(error**2))))

    row(
        "plain 10 km across: phase of every ray, X band",
        phase_noise(got),
        1.0,
        "deg rms",
        naive=phase_noise(np.linalg.norm(landed - antenna, axis=1)),
        remedy="the float64 ray's own point of the facet's plane",
    )
