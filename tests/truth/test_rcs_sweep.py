"""Sweeps of a scene's radar cross section against closed forms and brute force, at random aspects."""

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh

import sarmitsuba
from sarmitsuba.core.errors import RadarError
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.machine.backend import dr
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.turntable import (
    Aspects,
    RcsSweep,
    image_refusal,
    rcs_sweep,
    turntable_scene,
    undersampling,
)
from sarmitsuba.truth import theory as theory_of_pairs
from sarmitsuba.truth.theory import canonical_rcs as theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.cases.courtyards import RADIUS, bowl
from tests.support.draws import few_of
from tests.support.unweighted import focus

FREQUENCY = 3e9
WAVELENGTH = 299792458.0 / FREQUENCY
# the radar's own view of the scenes does not count here
pytestmark = pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")


def scene_of(
    *parts: Geometry | trimesh.Trimesh, points: Sequence[PointTarget] = (), material: str = "pec"
) -> Scene:
    meshes = [SceneMesh(part.vertices, part.faces, material, f"part_{i}") for i, part in enumerate(parts)]
    scene = build_scene(meshes, points, radar=RadarDescription(center_frequency=FREQUENCY))
    return scene.replace(
        edge_diffraction="off", full_wave="off"
    )  # the closed forms here are of physical optics


def sweep(scene: Scene, azimuth: np.ndarray, elevation: np.ndarray | float, *channels: str) -> RcsSweep:
    azimuth, elevation = np.broadcast_arrays(np.asarray(azimuth, dtype=float), elevation)
    return rcs_sweep(
        scene, Aspects(azimuth, np.asarray(elevation, dtype=float)), channels=channels or ("HH", "VV")
    )


def total(result: RcsSweep, channel: str) -> np.ndarray:
    return result.result.amplitude[:, :, result.result.channels.index(channel)].sum(axis=1)


def test_plate_is_the_closed_form_with_its_phase() -> None:
    rng = np.random.default_rng(1)
    azimuth, elevation = rng.uniform(0, 2 * np.pi, 40), rng.uniform(0.5, 1.5, 40)
    result = sweep(scene_of(targets.plate(0.8, 0.5)), azimuth, elevation)
    look = result.aspects.directions
    expected = theory.plate_amplitude(0.8, 0.5, WAVELENGTH, look[:, 0], look[:, 1])
    for channel in ("HH", "VV"):
        # tol: float32 sums of the kernel, -60 dB of the plate's peak
        assert np.abs(total(result, channel) - expected).max() < 1e-3 * theory.plate_amplitude(
            0.8, 0.5, WAVELENGTH, 0
        )
    assert result.orders == (1,) and max(result.error_db) < -40.0


def test_dihedral_at_random_azimuths() -> None:
    rng = np.random.default_rng(2)
    azimuth = rng.uniform(0.1, 0.5 * np.pi - 0.1, 40)
    result = sweep(scene_of(targets.dihedral(0.7, 0.9, 0.6)), azimuth, 0.0)
    # the face along +x has the normal +y: the angle between the look and it is 90 degrees less the azimuth
    expected = theory.dihedral(0.7, 0.9, 0.6, WAVELENGTH, 0.5 * np.pi - azimuth)
    peak = np.abs(expected.perpendicular).max()
    # the corner line is upright: V is along it
    for channel, amplitude in (("VV", expected.parallel), ("HH", expected.perpendicular)):
        # tol: 4.5 rays per wavelength over faces of 6 to 9 wavelengths: the doubly lit strip's edge, 0.1 dB
        assert np.abs(np.abs(total(result, channel)) - np.abs(amplitude)).max() < 0.012 * peak
    assert result.orders == (1, 2)


def test_trihedral_about_its_axis() -> None:
    rng = np.random.default_rng(3)
    azimuth = np.pi / 4 + rng.uniform(-0.2, 0.2, 25)
    elevation = np.arcsin(1 / np.sqrt(3)) + rng.uniform(-0.2, 0.2, 25)
    result = sweep(scene_of(targets.trihedral(1.5, "triangular")), azimuth, elevation, "VV")
    expected = 10 * np.log10(theory.trihedral_rcs(1.5, WAVELENGTH, result.aspects.directions))
    # tol: rims of the triple-lit patch in rays of 0.02 m, 0.2 dB
    assert np.abs(result.dbsm("VV", 3) - expected).max() < 0.3


def test_sphere_is_the_same_from_everywhere() -> None:
    rng = np.random.default_rng(4)
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.6)
    result = sweep(scene_of(ball), rng.uniform(-np.pi, np.pi, 12), rng.uniform(-1.5, 1.5, 12))
    exact = 10 * np.log10(np.pi * 0.36)
    for channel in ("HH", "VV"):
        # tol: physical optics of ka = 38 ends at the shadow line with 1 / ka = 0.2 dB, facets and rays as much
        assert np.abs(result.dbsm(channel) - exact).max() < 0.5


def brute_force(box: trimesh.Trimesh, look: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Physical optics of a convex body by summing up points of its lit faces, in NumPy."""
    k, out = 2 * np.pi / WAVELENGTH, np.zeros(len(look), dtype=complex)
    n = 120
    # midpoints of n^2 similar triangles of a facet
    i, j = (v.ravel() for v in np.meshgrid(np.arange(n), np.arange(n)))
    low, high = i + j < n, i + j < n - 1
    u = np.concatenate([(i[low] + 1 / 3) / n, (i[high] + 2 / 3) / n])
    v = np.concatenate([(j[low] + 1 / 3) / n, (j[high] + 2 / 3) / n])
    for a, b, c in box.triangles:
        normal = np.cross(b - a, c - a)
        points = a + u[:, None] * (b - a) + v[:, None] * (c - a) - center
        area = 0.5 * np.linalg.norm(normal) / n**2
        cosine = look @ (normal / np.linalg.norm(normal))
        for m in np.flatnonzero(cosine > 0):
            out[m] += cosine[m] * area * np.exp(2j * k * (points @ look[m])).sum()
    return 2 * np.sqrt(np.pi) / WAVELENGTH * out


@pytest.mark.parametrize("seed", few_of([11, 12, 13]))
def test_random_box_is_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = trimesh.creation.box(extents=rng.uniform(0.3, 0.9, 3))
    box.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    box.apply_translation(rng.uniform(-2, 2, 3))
    azimuth, elevation = rng.uniform(-np.pi, np.pi, 25), rng.uniform(-1.5, 1.5, 25)
    result = sweep(scene_of(box), azimuth, elevation)
    expected = brute_force(box, result.aspects.directions, box.bounds.mean(axis=0))
    assert result.max_depth == 1  # proven convex: no second bounce is looked for
    for channel in ("HH", "VV"):
        error = np.sqrt(np.mean(np.abs(total(result, channel) - expected) ** 2))
        # tol: the brute sum's cells of 8 mm (kh)^2 / 24 = 1 % of what each sums to, our rays -50 dB
        assert error < 0.012 * np.sqrt(np.mean(np.abs(expected) ** 2))


def test_sweep_is_as_symmetric_as_the_target() -> None:
    azimuth = np.radians(np.arange(0.0, 360.0, 5.0))
    result = sweep(sarmitsuba.load_scene("dihedral"), azimuth, np.radians(30.0))
    mirrored = np.roll(total(result, "HH")[::-1], 1)
    scale = np.abs(total(result, "HH")).max()
    # tol: the lattice is not symmetric; flat faces tile to float32
    assert np.abs(total(result, "HH") - mirrored).max() < 1e-3 * scale
    assert result.dbsm("HH")[36] == result.dbsm("HH").max()


def test_straight_from_above_polarisation_is_that_of_the_azimuth() -> None:
    """A V groove along x from the zenith: H lies across the azimuth, so its scattering matrix is rolled by it."""
    width = 0.5
    groove = targets.dihedral(width, width, 0.8)
    # the corner line z becomes x, the bisector of the faces becomes up
    turn = np.array([[0.0, 0.0, 1.0], [np.sqrt(0.5), -np.sqrt(0.5), 0.0], [np.sqrt(0.5), np.sqrt(0.5), 0.0]])
    mesh = trimesh.Trimesh(groove.vertices @ turn.T, groove.faces, process=False)
    azimuth = np.radians(37.0)
    elevation = np.radians([89.99, 90.0])
    result = rcs_sweep(scene_of(mesh), Aspects(np.full(2, azimuth), elevation), channels=("HH", "HV", "VV"))
    got = result.result.amplitude.sum(axis=1)
    # tol: 0.01 degrees turn the phase by 2 k 0.5 m 1.7e-4 = 0.01 rad
    assert np.abs(got[0] - got[1]).max() < 0.02 * np.abs(got).max()
    # H at 37 + 90 degrees from x, the groove's line: tau between them
    roll = azimuth + 0.5 * np.pi
    expected = np.abs(theory.rolled_dihedral(1.0, roll))
    peak = np.linalg.norm(got[1][[0, 2]]) / np.sqrt(2.0) / np.abs(np.cos(2 * roll))
    # tol: single bounces of the slanted faces, and rays over 5 wavelengths: 2 %
    assert np.abs(np.abs(got[1]) / peak - [expected[0, 0], expected[0, 1], expected[1, 1]]).max() < 0.03


def test_points_interfere_and_hide() -> None:
    gap = 0.7
    points = [
        PointTarget("a", np.array([0.0, gap / 2, 0.0])),
        PointTarget("b", np.array([0.0, -gap / 2, 0.0]), 4.0),
    ]
    azimuth = np.random.default_rng(5).uniform(0, 2 * np.pi, 30)
    result = sweep(scene_of(points=points), azimuth, 0.3, "HH", "HV")
    phase = 4 * np.pi / WAVELENGTH * gap * np.sin(azimuth) * np.cos(0.3)
    assert np.allclose(np.abs(total(result, "HH")) ** 2, 5.0 + 4.0 * np.cos(phase), atol=1e-9)
    assert not total(result, "HV").any()
    wall = SceneMesh(
        [[0.0, -9, -9], [0, 9, -9], [0, 9, 9], [0, -9, 9]], [[0, 1, 2], [0, 2, 3]], "pec", "wall"
    )
    radar = RadarDescription(center_frequency=FREQUENCY)
    hidden = build_scene([wall], [PointTarget("a", np.array([1.0, 0.0, 0.0]), 1e9)], radar=radar)
    front, back = sweep(hidden, np.array([0.1, np.pi - 0.1]), 0.1, "VV").dbsm("VV")
    assert front > 85.0 and back < 40.0


def test_directions_share_launches() -> None:
    """A launch per batch of directions, whatever their number; the checked directions take a few more."""
    changes = {"sar_antenna.center_frequency": "1e9", "sar_path.full_wave": "off"}
    scene = sarmitsuba.load_scene("plate", parameters=changes)
    counts = []
    for n in (40, 400):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            sweep(scene, np.linspace(0.0, 6.0, n), 0.5)
            counts.append(len([k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]))
    assert counts[0] == counts[1]


@pytest.mark.parametrize(
    ("turn", "n"), [(40.0, 41), pytest.param(360.0, 180, marks=pytest.mark.slow)], ids=["arc", "circle"]
)
def test_image_of_an_arc_is_calibrated_and_in_place(turn: float, n: int) -> None:
    place = np.array([0.25, -0.4, 0.0])
    points = [PointTarget("a", place, 2.0), PointTarget("b", np.array([-0.5, 0.5, 0.0]), 0.5)]
    azimuth = np.radians(np.linspace(0.0, turn, n, endpoint=turn < 360.0))
    aspects = Aspects(azimuth, np.full(n, 0.5))
    scene = turntable_scene(scene_of(points=points), aspects, channels=("HH",))
    raw = sarmitsuba.simulate(scene)
    assert focus(raw).rcs("HH").max() < 2.2
    request = {"center_x": place[0], "center_y": place[1], "extent_azimuth": 0.1, "extent_range": 0.1}
    image = focus(raw, request=request)
    power = image.rcs("HH")
    row, column = np.unravel_index(int(power.argmax()), power.shape)
    assert np.linalg.norm(image.grid.positions_on_line(int(row))[int(column)] - place) < 1e-9
    # tol: side lobes of the other point, half as strong and 12 cells away: -25 dB of amplitude
    assert power.max() == pytest.approx(2.0, rel=0.06)


def test_what_cannot_be_swept_is_said() -> None:
    scene = scene_of(targets.plate(0.5, 0.5))
    with pytest.raises(RadarError, match="rotates only the polarisation"):
        sweep(scene, np.array([0.0, 1.0]), 0.5 * np.pi)
    assert "azimuth" in image_refusal(Aspects(np.zeros(3), np.linspace(0, 1, 3)))
    assert "elevation" in image_refusal(Aspects(np.linspace(0, 1, 31), np.full(31, -0.1)))
    assert not image_refusal(Aspects(np.linspace(0, 1, 31), np.zeros(31)))
    assert not image_refusal(Aspects(np.radians(np.arange(0, 20, 5.0)), np.zeros(4)))
    assert "30 deg apart" in image_refusal(Aspects(np.radians([0.0, 30.0, 60.0]), np.zeros(3)))


@pytest.mark.slow
def test_pairs_of_diffuse_scatterers_in_a_bowl() -> None:
    """What pairs add to the amplitude, its mean power over aspects against the closed form."""
    albedo, elevation = 0.3, 1.0
    vertices, faces = bowl()
    stone = {
        "material": "pec",
        "rms_height": 0.05,
        "diffuse_law": "lambert",
        "diffuse_level_db": 10.0 * np.log10(4.0 * albedo),
    }
    radar = RadarDescription(center_frequency=FREQUENCY)
    scene = build_scene([SceneMesh(vertices, faces, stone, "bowl")], radar=radar)
    scene = scene.replace(coherent="off", max_depth=2, ray_spacing=0.5, scatterer_cell=0.1)
    azimuth = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    aspects = Aspects(azimuth, np.full(azimuth.size, elevation))
    on, off = (
        rcs_sweep(scene.replace(diffuse_pairs=switch), aspects, channels=("HH", "HV", "VV"), checked=0)
        for switch in ("on", "off")
    )
    closed = theory_of_pairs.lambertian_bowl(RADIUS, albedo, 0.5 * np.pi - elevation, 0.0)
    for channel, want in (("HH", closed.co_h), ("HV", closed.cross), ("VV", closed.co_v)):
        got = np.mean(np.square(np.abs(total(on, channel) - total(off, channel))))
        # tol: four standard deviations of speckle over the aspects, and of the draw
        assert got == pytest.approx(float(want), rel=4.0 / np.sqrt(azimuth.size) + 0.05)


def test_steps_wider_than_lobes_are_told() -> None:
    """Lobes of a trihedral of 1 m, 1.58 m across, are 0.56 deg wide at X band: 5 deg miss most, 1 deg do not."""
    scene = sarmitsuba.load_scene("trihedral")
    for step, told in ((5.0, True), (1.0, False)):
        azimuth = np.radians(np.arange(90.0, 270.0 + step, step))
        found = undersampling(scene, Aspects(azimuth, np.full(azimuth.size, 0.5)))
        assert bool(found) == told
    (text,) = undersampling(scene, Aspects(np.radians([0.0, 5.0]), np.zeros(2)))
    assert "steps of 5 deg" in text and "0.56 deg" in text
    assert undersampling(scene, Aspects(np.zeros(1), np.zeros(1))) == ()
