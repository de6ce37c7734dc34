"""The trace kernel in the far field against closed forms: facets, corner reflectors, sphere."""

import numpy as np
import pytest

from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.materials.material import Material
from sarmitsuba.mesh.tessellate import sphere
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.simulation.rcs import monostatic_rcs

FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY
PEC = (Material("pec", pec=True),)


def target(vertices: list[list[float]], faces: list[list[int]]) -> Geometry:
    n = len(faces)
    zero = np.zeros(n, dtype=np.int32)
    return Geometry(
        np.array(vertices, dtype=np.float64),
        np.array(faces, dtype=np.int32),
        zero,
        zero,
        ("t",),
        np.array([0, n]),
    )


PLATE = target([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]], [[0, 1, 2], [0, 2, 3]])
DIHEDRAL = target(
    [[0, -0.5, 0], [1, -0.5, 0], [1, 0.5, 0], [0, 0.5, 0], [0, -0.5, 1], [0, 0.5, 1]],
    [[0, 1, 2], [0, 2, 3], [0, 3, 5], [0, 5, 4]],
)
TRIHEDRAL = target([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 2, 3], [0, 3, 1]])


def test_plate_at_and_off_normal_incidence() -> None:
    """Physical optics of a 1 m plate: 4 pi A^2 / lambda^2 (cos t sinc(k a sin t))^2, HH = VV."""
    angle = np.radians([0.0, 0.5, 2.2, 5.0])
    look = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    result = monostatic_rcs(PLATE, PEC, look, FREQUENCY, max_depth=1)
    pattern = np.cos(angle) * np.sinc(2.0 * np.sin(angle) / WAVELENGTH)
    theory = 10 * np.log10(4 * np.pi / WAVELENGTH**2 * pattern**2)
    # tol: discretisation, the rim is resolved to a fifth of a wavelength
    np.testing.assert_allclose(result.rcs_dbsm("HH"), theory, atol=0.05)
    np.testing.assert_allclose(result.rcs_dbsm("VV"), theory, atol=0.05)


def test_dihedral_level_and_polarisation_phase() -> None:
    """8 pi a^2 b^2 / lambda^2 at 45 degrees, HH and VV in opposite phase."""
    result = monostatic_rcs(DIHEDRAL, PEC, [[1.0, 0.0, 1.0]], FREQUENCY, ray_spacing=2 / 32)
    theory = 10 * np.log10(8 * np.pi / WAVELENGTH**2)
    hh, vv = result.amplitude[0].sum(axis=0)
    # tol: discretisation, 32 rays across the launch window
    np.testing.assert_allclose(result.rcs_dbsm("HH"), theory, atol=0.05)
    np.testing.assert_allclose(result.rcs_dbsm("VV"), theory, atol=0.05)
    # tol: the single bounces off both plates turn the sum by -0.80 degrees, part of it lost with coarse rays
    assert abs(np.degrees(np.angle(-hh / vv)) + 0.8) < 0.3


def test_trihedral_on_boresight() -> None:
    """4 pi a^4 / (3 lambda^2), three bounces."""
    result = monostatic_rcs(TRIHEDRAL, PEC, [[1.0, 1.0, 1.0]], FREQUENCY)
    theory = 10 * np.log10(4 * np.pi / (3 * WAVELENGTH**2))
    # tol: discretisation of the hexagonal aperture's rim, and single and double bounces
    np.testing.assert_allclose(result.rcs_dbsm("HH"), theory, atol=0.1)
    orders = monostatic_rcs(TRIHEDRAL, PEC, [[1.0, 1.0, 1.0]], FREQUENCY, keep_orders=True)
    np.testing.assert_allclose(orders.amplitude.sum(axis=1), result.amplitude[:, 0], rtol=1e-3)
    assert np.abs(orders.amplitude[0, 2, 0]) > 30 * np.abs(orders.amplitude[0, :2, 0]).max()


@pytest.mark.parametrize("ka", [60.0])
def test_sphere_is_geometric_optics(ka: float) -> None:
    """A large sphere returns pi a^2; physical optics ripples by 1 / ka about it."""
    radius = ka * WAVELENGTH / (2 * np.pi)
    vertices, faces = sphere(radius, WAVELENGTH / 512)
    n = faces.shape[0]
    zero = np.zeros(n, dtype=np.int32)
    ball = Geometry(vertices, faces, zero, zero, ("s",), np.array([0, n]))
    look = np.random.default_rng(1).normal(size=(6, 3))
    result = monostatic_rcs(ball, PEC, look, FREQUENCY, max_depth=1)
    # tol: facets of sagitta lambda / 512 and 4.5 rays a wavelength
    np.testing.assert_allclose(result.rcs_dbsm("VV"), 10 * np.log10(np.pi * radius**2), atol=0.2)


def test_tessellation_does_not_matter() -> None:
    """The same plate in 2 and in 800 triangles."""
    m = 20
    x = np.linspace(-0.5, 0.5, m + 1)
    vertices = [[a, b, 0.0] for a in x for b in x]
    faces = []
    for i in range(m):
        for j in range(m):
            a = i * (m + 1) + j
            faces += [[a, a + m + 1, a + m + 2], [a, a + m + 2, a + 1]]
    fine = target(vertices, faces)
    look = [[0.1, 0.03, 1.0], [0.0, 0.0, 1.0]]
    one = monostatic_rcs(PLATE, PEC, look, FREQUENCY, max_depth=1)
    many = monostatic_rcs(fine, PEC, look, FREQUENCY, max_depth=1)
    # tol: float32 rounding decides which of two touching triangles a ray hits
    np.testing.assert_allclose(one.amplitude, many.amplitude, atol=1e-3 * np.abs(one.amplitude).max())


def test_permittivity_one_returns_nothing_and_metal_is_the_perfect_limit() -> None:
    """Vacuum reflects exactly nothing; 1e7 S/m is a perfect conductor to 0.01 dB."""
    air = (Material("air", permittivity=1.0 + 0j),)
    assert not np.any(monostatic_rcs(DIHEDRAL, air, [[1.0, 0.0, 1.0]], FREQUENCY, ray_spacing=0.05).amplitude)
    metal = (Material("metal", permittivity=1.0 - 1.8e7j),)
    a = monostatic_rcs(DIHEDRAL, metal, [[1.0, 0.0, 1.0]], FREQUENCY, ray_spacing=0.05).rcs_dbsm("HH")
    b = monostatic_rcs(DIHEDRAL, PEC, [[1.0, 0.0, 1.0]], FREQUENCY, ray_spacing=0.05).rcs_dbsm("HH")
    np.testing.assert_allclose(a, b, atol=0.01)  # tol: loss 4 Rs / eta of a real metal, twice
