"""What is off, or set to nothing, costs nothing: the same kernels and the same bits as where it is not mentioned."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import Motion, PointTarget, RadarDescription, Scene, SceneMesh, build_scene, simulate
from sarmitsuba.core.arrays import C64
from sarmitsuba.machine.backend import dr
from sarmitsuba.radar.film import FilmDescription

RADAR = RadarDescription(
    slant_range=2e3,
    heading_deg=37.0,
    bandwidth=75e6,
    azimuth_resolution=4.0,
    pattern="rectangular",
    antenna_length=1.0,
    elevation_beamwidth_deg=20.0,
    aim_x=0.0,
    aim_y=0.0,
    aim_z=0.0,
)
FILM = FilmDescription(image_extent_azimuth=20.0, image_extent_range=20.0)
GROUND = np.array([[-8.0, -8.0, 0.0], [8.0, -8.0, 0.0], [8.0, 8.0, 0.0], [-8.0, 8.0, 0.0]])
WALL = np.array([[-3.0, 2.0, 0.0], [3.0, 1.0, 0.0], [3.0, 1.0, 4.0], [-3.0, 2.0, 4.0]])
FACES = [[0, 1, 2], [0, 2, 3]]
NOTHING = Motion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def scene_of(radar: RadarDescription = RADAR, motion: Motion | None = None, **settings: str) -> Scene:
    """Ground and a wall before it, and an ideal point; the wall and the point may move."""
    more = {} if motion is None else {"motion": motion}
    mirror = {"material": "concrete", "smooth": True}
    shapes = [SceneMesh(GROUND, FACES, mirror, "ground"), SceneMesh(WALL, FACES, "pec", "wall", **more)]
    points = [PointTarget("point", np.array([2.0, -3.0, 0.5]), 1.0, **more)]
    scene = build_scene(shapes, points, radar=radar, film=FILM)
    return scene.replace(**settings) if settings else scene


def run(scene: Scene) -> tuple[C64, set[str]]:
    """Raw data, and the kernels that made them."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        data = simulate(scene, seed=1).data
        kernels = {str(kernel["hash"]) for kernel in dr.kernel_history([dr.KernelType.JIT])}
    return data, kernels


NO_EFFECT = {"moving_targets": "off", "diffuse_pairs": "off", "motion_in_pulse": "off"}
DRIVING = Motion((2.0, 3.0, 0.0))
MENTIONED = replace(
    RADAR,
    receiver_offset_across=0.0,
    pass_offset_up=0.0,
    pri_sequence="2,2,2",
    prf_jitter=0.0,
    pointing_error_azimuth_deg=0.0,
    latitude_deg=48.0,
)

pytestmark = pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # effects switched off


def test_what_is_off_or_nothing_is_as_if_it_were_not_there() -> None:
    plain, kernels = run(scene_of())
    assert np.abs(plain).max() > 0.0 and len(kernels) > 1
    later = scene_of()
    later = replace(later, settings=replace(later.settings, pass_days=12.0))
    changing = scene_of()
    changing = replace(
        changing, materials=tuple(replace(m, temporal_coherence=0.1) for m in changing.materials)
    )
    for scene in (scene_of(MENTIONED, NOTHING), scene_of(motion=DRIVING, **NO_EFFECT), later, changing):
        data, same = run(scene)
        assert np.array_equal(data, plain)
        assert same == kernels


@pytest.mark.slow
def test_what_is_on_leaves_no_trace_in_what_comes_after_it() -> None:
    plain, kernels = run(scene_of())
    for name, scene in {
        "moving": scene_of(motion=DRIVING),
        "two antennas": scene_of(replace(RADAR, receiver_offset_across=20.0)),
        "motion in pulse": scene_of(motion_in_pulse="on"),
    }.items():
        data, other = run(scene)
        assert not np.array_equal(data, plain), name
        assert other != kernels, name
    data, same = run(scene_of())
    assert np.array_equal(data, plain) and same == kernels
