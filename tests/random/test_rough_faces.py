"""Drawn rough plates and roofs towards the antenna: where the plan leaves the coherent return out, it is negligible."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.planning.pilot import plan_scene
from tests.support.unweighted import focus

F64 = NDArray[np.float64]
SIZE = 24.0


def rectangle(centre: F64, first: F64, second: F64) -> tuple[F64, NDArray[np.int64]]:
    corners = [
        centre - first - second,
        centre + first - second,
        centre + first + second,
        centre - first + second,
    ]
    return np.array(corners, dtype=float), np.array([[0, 1, 2], [0, 2, 3]])


def drawn(seed: int) -> Scene:
    """A square plate alone, or above ground, perpendicular to the line of sight at a drawn pulse or nearly so."""
    rng = np.random.default_rng(seed)
    frequency = float(rng.choice([1.3e9, 5.3e9, 9.6e9]))
    height = rng.uniform(1.6, 2.6) * 299_792_458.0 / (2.0 * np.pi * frequency)
    resolution = max(0.7, 8.0 * 299_792_458.0 / frequency)
    radar = RadarDescription(
        center_frequency=frequency,
        bandwidth=150e6 / resolution,
        azimuth_resolution=resolution,
        slant_range=float(rng.choice([4e3, 20e3])),
        look_angle_deg=float(rng.uniform(25.0, 50.0)),
        heading_deg=float(rng.uniform(0.0, 360.0)),
        mode=str(rng.choice(["spotlight", "stripmap"])),
        polarisation=str(rng.choice(["VV", "HH"])),
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    film = FilmDescription(image_extent_azimuth=1.3 * SIZE, image_extent_range=1.3 * SIZE)
    material = {
        "material": "concrete",
        "rms_height": height,
        "diffuse_law": "lambert",
        "diffuse_level_db": -12.0,
    }
    ground = rectangle(np.zeros(3), np.array([0.5 * SIZE, 0, 0]), np.array([0, 0.5 * SIZE, 0]))
    first_look = build_scene(
        meshes=[SceneMesh(*ground, material, "ground")], radar=radar, film=film, settings=TraceSettings()
    )
    track = first_look.radar.track.position
    normal = track[rng.choice([0, len(track) // 2, len(track) - 1])] + first_look.offset
    normal = normal / np.linalg.norm(normal) + rng.normal(size=3) * rng.choice([0.0, 1e-3, 1e-2])
    side = np.cross(normal, [0.0, 0.0, 1.0])
    side *= 0.3 * SIZE / np.linalg.norm(side)
    up = np.cross(normal / np.linalg.norm(normal), side)
    alone = rng.random() < 0.4
    plate = rectangle(np.array([0.0, 0.0, 0.0 if alone else 0.25 * SIZE]), side, up)
    meshes = [SceneMesh(*plate, material, "plate")]
    if not alone:
        meshes.append(SceneMesh(*ground, material, "ground"))
    settings = TraceSettings(keep_orders=not alone)  # so that a pilot decides
    return build_scene(meshes=meshes, radar=radar, film=film, settings=settings)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*is switched off")
def test_coherent_returns_left_out_are_below_the_tolerance() -> None:
    off = 0
    for seed in range(24):
        scene = drawn(seed)
        decision = plan_scene(scene).decision("coherent")
        assert decision is not None
        if decision.on:
            continue
        off += 1
        energy = []
        for switches in ({"coherent": "off"}, {"coherent": "on", "diffuse": "off"}):
            ways = {**switches, "edge_diffraction": "off"}  # the roughness of edges is not modelled
            image = focus(simulate(replace(scene, settings=replace(scene.settings, effects=ways))))
            energy.append(float(np.sum(np.abs(image.total(image.channels[0])) ** 2, dtype=np.float64)))
        left_out = 10.0 * np.log10(max(energy[1] / energy[0], 1e-30))
        assert left_out <= scene.settings.tolerance_db + 1.0, (seed, decision.why, left_out)
    assert off >= 5
