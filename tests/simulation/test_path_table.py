"""The path table against the raw data that the same paths add up to, and against geometry."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import sarmitsuba
from sarmitsuba.core.errors import RadarError
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.ground import continue_ground
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.execution.path_table import KINDS, PathTable, trace_paths

FEW = {"sar_antenna.n_pulses": "6", "sar_path.gridding_width": "8", "sar_path.method": "raw"}


def random_scene(seed: int, more: Sequence[SceneMesh] = ()) -> Scene:
    """Ground, boxes that overlap and touch, a bent roof and points, at random, in four polarisations."""
    rng = np.random.default_rng(seed)
    rough = {"material": "concrete", "rms_height": 0.004, "diffuse_law": "lambert"}
    half = 9.0
    ground = SceneMesh(
        [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]],
        [[0, 1, 2], [0, 2, 3]],
        rough,
        "ground",
    )
    meshes = [ground, *more]
    for i in range(3):
        box = trimesh.creation.box(extents=rng.uniform(1.0, 4.0, 3))
        move = trimesh.transformations.rotation_matrix(rng.uniform(0.0, 6.0), [0, 0, 1])
        move[:3, 3] = [*rng.uniform(-4.0, 4.0, 2), rng.uniform(0.5, 2.0)]
        kind = [
            {"material": "metal", "smooth": True},
            {"material": "brick", "rms_height": 0.002, "diffuse_law": "lambert"},
            rough,
        ][i]
        meshes.append(SceneMesh.of(box, kind, f"box{i}", to_world=move))
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    ball.apply_translation([*rng.uniform(-4.0, 4.0, 2), 3.0])
    meshes.append(SceneMesh.of(ball, {"material": "metal", "smooth": True}, "ball", smooth=True))
    points = [
        PointTarget(
            "p", rng.uniform([-8, -8, 0.5], [8, 8, 6.0]), rng.uniform(1.0, 5.0), rng.uniform(0.0, 6.0)
        )
    ]
    radar = RadarDescription(
        slant_range=rng.uniform(800.0, 3000.0),
        look_angle_deg=rng.uniform(25.0, 60.0),
        heading_deg=rng.uniform(0.0, 360.0),
        squint_angle_deg=rng.uniform(-15.0, 15.0),
        n_pulses=6,
        polarisation="HH,HV,VH,VV",
    )
    film = FilmDescription(image_extent_azimuth=14.0, image_extent_range=14.0, gridding_width=8)
    settings = TraceSettings(
        method="raw", max_depth=4, ray_spacing=0.12, diffuse_ray_spacing=0.2, gridding_width=8, seed=seed
    )
    return build_scene(meshes, points, radar=radar, film=film, settings=settings)


def binned(table: PathTable, scene: Scene, pulse: int) -> np.ndarray:
    """Every path added to the receiver's samples by its definition, (n_channels, n_samples)."""
    window, cell = scene.radar.window, scene.radar.waveform.range_cell
    sample = window.start_range[pulse] + np.arange(window.n_samples) * window.sample_spacing
    total = np.zeros((len(table.channels), window.n_samples), dtype=np.complex128)
    mine = table[table.pulse == pulse]
    for start in range(0, len(mine), 20_000):
        part = mine[start : start + 20_000]
        total += part.amplitude.T @ np.sinc((sample - part.slant_range[:, None]) / cell)
    return total


def assert_sums_to_raw(scene: Scene, pulses: list[int]) -> PathTable:
    one_set = replace(scene, settings=replace(scene.settings, keep_subsets=False))
    table, raw = trace_paths(scene, pulses), sarmitsuba.simulate(one_set)
    assert raw.channels == table.channels
    for pulse in pulses:
        ours, theirs = binned(table, scene, pulse), raw.data[:, pulse]
        error = np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)
        # tol: float32 amplitudes and phases of up to a million paths, and the 8-wide gridding kernel
        assert 20.0 * np.log10(error) < -90.0, (scene.name, pulse)
    return table


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("dihedral", {"sar_path.ray_spacing": "0.02"}),
        pytest.param("tower", {"range_film.image_extent_azimuth": "9"}, marks=pytest.mark.slow),
        pytest.param(
            "urban_block",
            {"range_film.image_extent_azimuth": "9", "range_film.image_extent_range": "9"},
            marks=pytest.mark.slow,
        ),
    ],
)
@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
def test_paths_of_shipped_scenes_add_up_to_the_raw_data(name: str, more: dict[str, str]) -> None:
    plain = sarmitsuba.load_scene(name, parameters=FEW | more)
    window = plain.radar.window
    # room for multiple bounces: the raw data leave out what arrives later, with its side lobes
    far = float(window.start_range.max()) + window.extent + (40.0 if name == "urban_block" else 0.0)
    scene = plain.replace(near_range=float(window.start_range.min()), far_range=far)
    table = assert_sums_to_raw(scene, [0, 3])
    kinds = {KINDS[k] for k in np.unique(table.kind)}
    # edges of metal are scatterers
    wanted = {"coherent"} if name == "dihedral" else {"coherent", "diffuse", "reciprocal"}
    wanted |= set() if name == "tower" else {"scatterer"}
    assert kinds == wanted


@pytest.mark.parametrize("seed", [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 1, 3))])
@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
def test_paths_of_random_scenes(seed: int) -> None:
    scene = random_scene(seed).replace(edge_diffraction="off", diffuse_pairs="off")
    table = assert_sums_to_raw(scene, [1, 4])
    assert set(np.unique(table.kind)) == {0, 1, 2, 3} and table.order.max() > 3
    assert_geometry_holds(table, scene)
    assert_filters_hold(table, scene)


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 5, 6])
def test_paths_through_panes(seed: int) -> None:
    """A room of glass among boxes: every path of a ray that branches has its own hits."""
    plain, rng = random_scene(seed), np.random.default_rng(seed)
    glass = {"material": "glass", "smooth": True, "thickness": 0.006}
    panes = []
    for i in range(3):
        quad = np.array([[0.0, -4.0, 0.2], [0.0, 4.0, 0.2], [0.0, 4.0, 5.0], [0.0, -4.0, 5.0]])
        turn = trimesh.transformations.rotation_matrix(rng.uniform(0.0, 6.0), [0, 0, 1])[:3, :3]
        place = quad @ turn.T + [*rng.uniform(-4.0, 4.0, 2), 0.0]
        panes.append(SceneMesh(place, [[0, 1, 2], [0, 2, 3]], glass, f"pane{i}"))
    scene = random_scene(seed, panes).replace(wideband="off", diffuse_pairs="on")
    table = assert_sums_to_raw(scene, [2])
    bare = trace_paths(scene.replace(transmission="off"), [2])
    assert len(table) != len(bare) and set(np.unique(table.kind)) == {0, 1, 2, 3, 5}
    found = table[(table.kind != 3) & (table.kind != 5)]
    there = np.arange(found.points.shape[1]) < found.order[:, None]
    geometry = continue_ground(scene).geometry  # rays also hit the ground beyond its rim
    corners = geometry.vertices[geometry.faces[found.face[there]]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    off = np.einsum("ni,ni->n", found.points[there] - corners[:, 0], normal)
    assert np.abs(off).max() < 0.01  # tol: the face of a pane stands half its thickness before its facet
    antenna = scene.radar.track.position[2]
    line = np.concatenate([np.broadcast_to(antenna, (len(found), 1, 3)), found.points], axis=1)
    legs = np.nansum(np.linalg.norm(np.diff(line, axis=1), axis=2), axis=1)
    legs += np.linalg.norm(found.points[np.arange(len(found)), found.order - 1] - antenna, axis=1)
    # tol: delay in panes, 2 mm each, and middles of tubes; a hit of another path is metres away
    assert np.percentile(np.abs(legs - found.length), 99.0) < 0.3
    assert plain.geometry.n_faces < scene.geometry.n_faces


def assert_geometry_holds(table: PathTable, scene: Scene) -> None:
    """Bounces lie on the faces that are named, legs add up, mirrors mirror."""
    geometry = continue_ground(scene).geometry
    there = np.arange(table.points.shape[1]) < table.order[:, None]
    assert np.array_equal(np.isfinite(table.points).all(axis=2), there)
    traced = there & (table.kind != 3)[:, None]
    assert np.array_equal(table.face >= 0, traced)
    face = table.face[traced]
    corners = geometry.vertices[geometry.faces[face]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    off = np.einsum("ni,ni->n", table.points[traced] - corners[:, 0], normal)
    assert np.abs(off).max() < 1e-4  # tol: the float32 vector from a tube's middle to what is left of it
    assert np.array_equal(table.material[traced], geometry.face_material[face])
    mesh = np.array([int(np.flatnonzero(geometry.mesh_face_offset <= f)[-1]) for f in face[:500]])
    assert np.array_equal(table.shape[traced][:500], mesh)

    antenna = scene.radar.track.position[table.pulse]
    legs = np.linalg.norm(table.points[:, 0] - antenna, axis=1)
    legs += np.nansum(np.linalg.norm(np.diff(table.points, axis=1), axis=2), axis=1)
    last = table.points[np.arange(len(table)), table.order - 1]
    legs += np.linalg.norm(last - antenna, axis=1)
    diffuse = np.isin(table.kind, (1, 3)) & (table.order == 1)
    np.testing.assert_allclose(legs[diffuse], table.length[diffuse], rtol=1e-13)
    direct = table.order == 1
    # tol: of the first facet the middle of what is left, whose range is taken to first order over the tube
    assert np.abs(legs - table.length)[direct].max() < 1e-3
    assert np.median(np.abs(legs - table.length)[~direct]) < 0.02  # tol: second order in the tube's width
    reciprocal = table[table.kind == 2]
    assert (reciprocal.order % 2 == 1).all() and (reciprocal.order >= 3).all()
    for path, order in zip(reciprocal.points[:50], reciprocal.order[:50], strict=True):
        np.testing.assert_array_equal(path[:order], path[:order][::-1])


def assert_filters_hold(table: PathTable, scene: Scene) -> None:
    """By energy share and by pixel, against the whole table."""
    pulse = int(table.pulse[0])
    full = table[table.pulse == pulse]
    assert (np.diff(full.power) <= 0.0).all()
    few = trace_paths(scene, pulse, strongest=0.9)
    share = np.cumsum(full.power) / full.power.sum()
    assert len(few) == int(np.searchsorted(share, 0.9)) + 1 < 0.8 * len(full)
    np.testing.assert_allclose(few.power, full.power[: len(few)], rtol=1e-5)  # tol: order of ties

    point = full.points[len(full) // 3, 0]
    track, cell = scene.radar.track, scene.radar.waveform.range_cell
    way = track.position[pulse] - point
    distance = np.linalg.norm(way)
    near = trace_paths(scene, pulse, near=point, cells=0.7)
    inside = np.abs(full.slant_range - distance) <= 0.7 * cell
    assert 0 < len(near) <= inside.sum() < len(full)
    assert (np.abs(near.slant_range - distance) <= 0.7 * cell).all()
    rate = way @ track.velocity[pulse] / distance
    reach = np.abs(near.range_rate - rate).max()
    missed = inside & (np.abs(full.range_rate - rate) < 0.99 * reach)
    assert missed.sum() <= len(near)
    speed = np.linalg.norm(track.velocity[pulse])
    # one step of an azimuth cell along the track changes the rate by at most its share of the range
    assert reach <= 0.7 * sarmitsuba_cell(scene) * speed / distance * 1.001


def sarmitsuba_cell(scene: Scene) -> float:
    """Wavelength over twice the angle that the aperture turns by, or what the stripmap states."""
    if np.isfinite(scene.radar.half_aperture):
        return float(scene.radar.waveform.wavelength / (4.0 * scene.radar.half_aperture))
    middle = np.array([scene.image.center_x, scene.image.center_y, scene.image.height])
    line = scene.radar.track.position[[0, -1]] - middle
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    return float(scene.radar.waveform.wavelength / (2.0 * np.arccos(line[0] @ line[1])))


def test_a_corner_returns_to_the_antenna_it_came_from() -> None:
    """Double bounces of a dihedral unfold to one slant range: that of its edge."""
    scene = sarmitsuba.load_scene("dihedral", parameters=FEW)
    table = trace_paths(scene)
    table = table[table.kind == KINDS.index("coherent")]  # without the plates' edges
    double = table[(table.order == 2) & (table.power > 0.1 * table.power.max())]
    low, high = scene.geometry.bounds
    antenna = scene.radar.track.position[scene.radar.track.center_index]
    assert len(double) > 50
    edge = 0.5 * (low + high)
    corner = np.array([low[0] if abs(low[0]) < abs(high[0]) else high[0], edge[1], low[2]])
    to_edge = np.linalg.norm(corner - antenna)
    # tol: along the edge the range grows by its square over twice the range
    assert np.abs(np.median(double.slant_range) - to_edge) < 0.05 + 0.5 * (high[1] - low[1]) ** 2 / to_edge
    assert (double.face[:, 0] != double.face[:, 1]).all()
    assert {table.material_names[m] for m in np.unique(double.material[:, :2])} <= set(table.material_names)


def test_the_same_rows_in_the_same_order() -> None:
    """Threads record paths as they come."""
    first, second = (trace_paths(sarmitsuba.load_scene("dihedral", parameters=FEW), [2]) for _ in range(2))
    for name in ("kind", "order", "length", "amplitude", "points", "face"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_short_text_and_rows() -> None:
    scene = sarmitsuba.load_scene("dihedral", parameters=FEW)
    table = trace_paths(scene, [2, -1, 2])
    assert set(np.unique(table.pulse)) == {2, 5}
    text = repr(table)
    assert "\n" not in text and len(text) < 120 and "coherent" in text and "2 pulses" in text
    assert (
        len(table[:7]) == 7
        and len(table[3]) == 1
        and len(table[table.order == 1]) == (table.order == 1).sum()
    )


@pytest.mark.parametrize(
    ("call", "text"),
    [
        ({"pulses": 6}, "pulse 6 is not there; the track has the pulses 0 ... 5"),
        ({"strongest": 0.0}, "strongest = 0 is not a share"),
        ({"strongest": 1.5}, "strongest = 1.5 is not a share"),
        ({"near": [0.0, 1.0]}, "give one finite point"),
        ({"near": [0.0, 1.0, float("nan")]}, "give one finite point"),
        ({"cells": 0.0}, "cells = 0 is not above 0"),
    ],
)
def test_bad_calls_are_one_line(call: dict[str, object], text: str) -> None:
    scene = sarmitsuba.load_scene("dihedral", parameters=FEW)
    with pytest.raises(RadarError, match=text) as caught:
        trace_paths(scene, **call)
    assert "\n" not in str(caught.value)
