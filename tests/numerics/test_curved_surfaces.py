"""Curved surfaces as facets: spheres and cylinders against their closed forms, over directions."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.loading.collect import SAGITTA_OVER_WAVELENGTH
from sarmitsuba.scene.mesh import smooth_surface as curvature
from sarmitsuba.scene.mesh.smooth_surface import facet_curvature
from sarmitsuba.scene.mesh.tessellate import cylinder, sphere
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.tracing.kernel.launch import frame_towards, lattice
from sarmitsuba.truth.theory.canonical_rcs import cylinder_rcs
from sarmitsuba.truth.theory.mie import sphere_po
from sarmitsuba.truth.validation.targets import PEC, geometry, parallelogram
from tests.support.paths import record_paths

FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY
LOOKS = np.random.default_rng(3).normal(size=(60, 3))


def sphere_error(ka: float, mesh: tuple[np.ndarray, np.ndarray]) -> float:
    """Largest deviation from physical optics over 60 random directions, dB."""
    radius = ka * WAVELENGTH / (2.0 * np.pi)
    result = monostatic_rcs(geometry([mesh]), PEC, LOOKS, FREQUENCY, max_depth=1, channels=("VV",))
    theory = 10 * np.log10(np.pi * radius**2 * sphere_po(ka))
    return float(np.abs(result.rcs_dbsm("VV") - theory).max())


def with_jitter(mesh: tuple[np.ndarray, np.ndarray], share: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices shifted at random along the sphere by up to a share of the mean edge."""
    v, f = mesh
    edge = np.linalg.norm(v[f] - v[np.roll(f, 1, axis=1)], axis=2).mean()
    moved = v + np.random.default_rng(1).uniform(-share, share, v.shape) * edge
    radius = np.linalg.norm(v, axis=1)
    return moved * (radius / np.linalg.norm(moved, axis=1))[:, None], f


@pytest.mark.parametrize("ka", [40.0, 60.0, pytest.param(120.0, marks=pytest.mark.slow)])
def test_sphere_at_a_sagitta_of_a_32nd_wavelength(row, ka: float) -> None:
    """Within 0.5 dB of the exact sphere in every direction.

    Naive way: facets as large as the sagitta allows, 1.3 wavelengths at ka = 60. They repeat regularly, so that the
    phase they add, +-0.1 rad, acts as a grating whose lobes interfere with the highlight: up to 1 dB, with the
    direction. Shifting the vertices at random makes it worse (the largest facets grow); facets below 0.55
    wavelengths, rows of them below half a wavelength apart, have no grating lobe.
    """
    radius = ka * WAVELENGTH / (2.0 * np.pi)
    plain = sphere(radius, WAVELENGTH / 32.0)
    naive = sphere_error(ka, plain)
    row(
        f"sphere ka = {ka:.0f}, sagitta lambda / 32, 60 directions: largest error",
        sphere_error(ka, sphere(radius, WAVELENGTH / 32.0, edge=0.55 * WAVELENGTH)),
        0.5,
        "dB",
        naive=naive,
        remedy="edges of facets below 0.55 wavelengths",
    )
    if ka == 60.0:
        assert sphere_error(ka, with_jitter(plain, 0.2)) > naive


@pytest.mark.parametrize("ka", [40.0, 60.0, pytest.param(200.0, marks=pytest.mark.slow)])
def test_sphere_as_a_scene_file_gets_it(row, ka: float) -> None:
    """The loader's own bound on facets, small spheres and large."""
    radius = ka * WAVELENGTH / (2.0 * np.pi)
    row(
        f"sphere ka = {ka:.0f} as loaded (sagitta lambda / {1 / SAGITTA_OVER_WAVELENGTH:.0f}): largest error",
        sphere_error(ka, sphere(radius, WAVELENGTH * SAGITTA_OVER_WAVELENGTH)),
        0.3,
        "dB",
    )


@pytest.mark.parametrize("wavelengths", [5.0, 20.0, 60.0])
def test_cylinder_as_a_scene_file_gets_it(row, wavelengths: float) -> None:
    """A cylinder seen broadside from 40 azimuths; strips of a 32nd wavelength's sagitta are a grating as well."""
    radius, height = wavelengths * WAVELENGTH, 10.0 * WAVELENGTH
    azimuth = np.linspace(0.1, 0.5, 40)
    look = np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=1)
    theory = 10 * np.log10(cylinder_rcs(radius, height, WAVELENGTH, exact=True))

    def error(sagitta: float) -> float:
        barrel = geometry([cylinder(radius, -height / 2, height / 2, sagitta)])
        result = monostatic_rcs(barrel, PEC, look, FREQUENCY, max_depth=1, channels=("VV",))
        return float(np.abs(result.rcs_dbsm("VV") - theory).max())

    row(
        f"cylinder of {wavelengths:.0f} wavelengths radius as loaded: largest error",
        error(WAVELENGTH * SAGITTA_OVER_WAVELENGTH),
        0.2,
        "dB",
        naive=error(WAVELENGTH / 32.0),
        remedy="sagitta of a 512th wavelength",
    )


def ways_by_the_plate(
    radius: float, height: float, elevation: float, *, smooth: bool = True
) -> tuple[float, float]:
    """Returns by way of sphere, then plate, and of plate, then sphere, over the sphere's own, dB.

    Without ``smooth`` every facet is a surface of its own: a polyhedron, whose facets are flat mirrors.
    """
    v, f = sphere(radius, WAVELENGTH / 512.0)
    reach = 12.0 * (radius + height)
    plate = parallelogram([-reach / 2, -reach / 2, 0], [reach, 0, 0], [0, reach, 0])
    scene = geometry([(v + np.array([0.0, 0.0, height]), f), plate])
    if not smooth:
        scene = replace(scene, face_group=np.arange(scene.n_faces, dtype=scene.face_group.dtype))
    look = np.array([np.cos(elevation), 0.0, np.sin(elevation)])
    levels = []
    for z in (height, -height):  # rays at the sphere, and at its mirror image; the two windows do not overlap
        center = np.array([0.0, 0.0, z])
        antenna = center + 1e5 * look
        frame = frame_towards(antenna[None], center, np.array([0.0, 1.0, 0.0]))
        grid = lattice(1.02 * radius, 1.02 * radius, WAVELENGTH / 4.5)
        paths = record_paths(scene, PEC, antenna, frame, grid, FREQUENCY)
        pick = paths.seen[1] & (np.hypot(grid.x, grid.y) < radius)
        phase = np.exp(-4j * np.pi / WAVELENGTH * (paths.slant_range[1][pick] - 1e5))
        total = (paths.amplitude[1][pick] * phase).sum() * 1e10
        levels.append(20 * np.log10(abs(total) / (np.sqrt(np.pi) * radius)))
    return levels[0], levels[1]


@pytest.mark.parametrize(
    ("wavelengths", "heights", "elevation_deg"),
    [
        (10.0, 3.0, 60.0),
        *(pytest.param(20.0, *v, marks=pytest.mark.slow) for v in ((1.5, 30.0), (3.0, 60.0))),
    ],
)
def test_divergence_behind_a_curved_mirror(
    row, wavelengths: float, heights: float, elevation_deg: float
) -> None:
    """A sphere above a large plate, double bounces one way and the other: each the bistatic sphere's pi a^2.

    By image theory both ways see the sphere from the antenna and its mirror image; geometrical optics gives pi a^2
    at any bistatic angle, and reciprocity makes the two ways alike.

    Naive way: rays leave facets as flat mirrors: their tubes do not spread with the beam behind the sphere.
    """
    radius = wavelengths * WAVELENGTH
    case = (radius, heights * radius, np.radians(elevation_deg))
    onward, back = ways_by_the_plate(*case)
    naive = max(ways_by_the_plate(*case, smooth=False), key=abs)
    name = f"sphere of {wavelengths:.0f} wavelengths, {heights:g} radii above a plate, {elevation_deg:.0f} degrees"
    # tol: facets, and tubes a tenth of a Fresnel zone wide after the spread
    row(
        f"{name}: sphere, then plate",
        abs(onward),
        1.5,
        "dB",
        naive=abs(naive),
        remedy="facets know the surface's curvature; tubes spread with it",
    )
    # tol: the same, and the share that closes on the plate where tubes behind the sphere are wide
    row(f"{name}: plate, then sphere", abs(back), 2.0, "dB")


def test_curvature_of_spheres_cylinders_and_flat_things() -> None:
    """S is (1 - n n) / r on a sphere, one direction of it on a cylinder, nothing on cubes and on coarse facets."""

    def of(mesh: tuple[np.ndarray, np.ndarray], wavelength: float = WAVELENGTH) -> np.ndarray | None:
        v, f = mesh
        table = facet_curvature(v[f], np.zeros(len(f), dtype=np.int32), wavelength)
        if table is None:
            return None
        s = np.zeros((len(f), 3, 3))
        for k, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]):
            s[:, i, j] = s[:, j, i] = table[:, k]
        return s

    ball = of(sphere(1.0, WAVELENGTH / 64.0))
    values = np.linalg.eigvalsh(ball)
    # tol: facets' normals for the surface's, edge^2 / r^2
    np.testing.assert_allclose(values[:, 1:], 1.0, atol=0.1)
    np.testing.assert_allclose(np.median(values[:, 1:]), 1.0, atol=0.01)
    assert np.abs(values[:, 0]).max() < 1e-6

    barrel = of(cylinder(0.5, 0.0, 3.0, WAVELENGTH / 64.0))
    values = np.linalg.eigvalsh(barrel)
    np.testing.assert_allclose(values[:, 2], 2.0, atol=0.02)
    assert np.abs(values[:, :2]).max() < 1e-6

    box = parallelogram([0, 0, 0], [1, 0, 0], [0, 1, 0], 50)
    assert of(box) is None  # flat
    assert of(sphere(10.0, WAVELENGTH)) is None  # a wavelength off: a polyhedron, taken at its face value
    v, f = cylinder(0.5, 0.0, 3.0, WAVELENGTH / 64.0)
    odd = np.random.default_rng(0).random(len(f)) < 0.5
    f = f.copy()
    f[odd] = f[odd][:, ::-1]  # wound at random: normals cancel at the corners
    assert of((v, f)) is None or np.abs(of((v, f))).max() <= 2.1
    assert curvature.LARGEST_SAGITTA == 0.125
