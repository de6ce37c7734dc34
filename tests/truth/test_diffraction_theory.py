"""Closed forms of edge diffraction against the eigenfunction series, each other and a strip solved numerically."""

import numpy as np
import pytest
from scipy.special import hankel2

from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.materials.wedge import fringe_bound
from sarmitsuba.truth import theory
from sarmitsuba.truth.theory.moments import strips_by_moments

FRAME = theory.WedgeFrame(1.5, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
EDGE = np.array([0.0, 0.0, 1.0])


def frame(n: float) -> theory.WedgeFrame:
    return theory.WedgeFrame(n, FRAME.inward, FRAME.normal)


def direction(phi: float, beta: float) -> F64:
    """Of a point at the angle phi round the edge, beta off the edge."""
    return np.array([np.cos(phi) * np.sin(beta), np.sin(phi) * np.sin(beta), np.cos(beta)])


def polarisations(d: F64) -> tuple[F64, F64]:
    """In the plane of a ray and the edge, and across it."""
    across = np.cross(d, EDGE)
    across = across / np.linalg.norm(across)
    return np.cross(across, d), across


@pytest.mark.parametrize("seed", range(6))
def test_on_the_cone_it_is_the_exact_coefficient_without_cross_polarisation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, beta = rng.uniform(1.05, 2.0), rng.uniform(0.3, np.pi - 0.3)
    phi, source = rng.uniform(0.05, n * np.pi - 0.05, 2)
    # the wave comes from beta off one end of the edge and leaves at beta off the other
    came, goes = direction(source, np.pi - beta), direction(phi, beta)
    soft, hard = theory.wedge_coefficients(n, phi, source)
    fields, receivers = polarisations(-came), polarisations(goes)
    whole = [
        [theory.fringe_strip(frame(n), came, goes, e, q, optics=True) for e in fields] for q in receivers
    ]
    want = 1j / np.sqrt(np.pi) * np.diag([complex(soft), complex(hard)])
    assert np.allclose(whole, want, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_off_the_cone_the_currents_are_those_of_the_series(seed: int) -> None:
    """Backscatter so oblique that every spectrum decays and the eigenfunction series converges term by term."""
    rng = np.random.default_rng(100 + seed)
    n, beta = rng.uniform(1.05, 2.0), rng.uniform(0.15, 0.6)
    came = direction(rng.uniform(0.05, n * np.pi - 0.05), beta)
    e, q = (rng.normal(size=3) + 1j * rng.normal(size=3) for _ in range(2))
    e, q = (x - came * (came @ x) for x in (e, q))
    d, h, total = -came, np.cross(-came, e), 0j
    for x, normal in frame(n).faces:
        z = np.cross(x, normal)
        phi = np.arctan2(came @ normal, came @ x) % (2.0 * np.pi)
        cosine, sine = d @ z, np.sin(beta)
        mu = (came @ x * sine + cosine * (came @ z - cosine)) / sine**2
        soft, hard = theory.wedge_current_series(n, phi, np.arccosh(-mu), 400)
        along = (e @ z * soft + cosine * (h @ z) * (mu * hard - 1.0 / n)) / sine**2
        total += q @ (along * z + h @ z * hard / sine * x)
    got = theory.fringe_strip(frame(n), came, came, e, q, optics=True)
    assert got == pytest.approx(1j / np.sqrt(np.pi) * total, rel=1e-8)


@pytest.mark.parametrize("n", [1.25, 1.5, 2.0])
def test_fringe_is_the_difference_and_finite_where_both_are_infinite(n: float) -> None:
    rng = np.random.default_rng(7)
    phi, source = rng.uniform(0.05, n * np.pi - 0.05, (2, 40))
    soft, hard = theory.fringe_coefficients(n, phi, source)
    exact, optics = theory.wedge_coefficients(n, phi, source), theory.optics_coefficients(n, phi, source)
    for got, a, b in zip((soft, hard), exact, optics, strict=True):
        apart = np.abs(a) < 20.0  # away from the boundaries
        assert np.allclose(got[apart], (a - b).real[apart], atol=1e-6)
    # boundaries of reflection and of shadow, and what lies a little beside them
    for side in (np.pi - 0.7, np.pi + 0.7):
        beside = [theory.fringe_coefficients(n, side + step, 0.7) for step in (-1e-4, 0.0, 1e-4)]
        assert np.allclose(beside[1], np.mean([beside[0], beside[2]], axis=0), atol=1e-5)
        across = [
            theory.fringe_strip(frame(n), direction(0.7, np.pi / 2), direction(side + 1e-6, np.pi / 2), e, e)
            for e in np.eye(3)[2:]
        ]
        assert across[0] == pytest.approx(1j / np.sqrt(np.pi) * float(beside[1][0]), abs=1e-3)


@pytest.mark.parametrize("one_antenna", [True, False])
def test_bound_of_drawn_wedges(one_antenna: bool) -> None:
    """The largest amplitude over polarisations against the whole current less the optical one; rims may be above."""
    rng = np.random.default_rng(3)
    count = 120
    n = np.where(rng.random(count) < 0.2, 2.0, rng.uniform(1.05, 1.95, count))
    wedges = [theory.WedgeFrame(float(x), *np.linalg.qr(rng.normal(size=(3, 3)))[0][:2]) for x in n]
    inward, normal = (np.array([[face[i] for face in wedge.faces] for wedge in wedges]) for i in (0, 1))
    edge = np.cross(inward[:, 0], normal[:, 0])

    def looks() -> F64:
        phi, along = rng.uniform(0.0, n * np.pi), rng.uniform(-0.95, 0.95, count)
        across = np.cos(phi)[:, None] * inward[:, 0] + np.sin(phi)[:, None] * normal[:, 0]
        return np.sqrt(1.0 - along**2)[:, None] * across + along[:, None] * edge

    source = looks()
    observer = source if one_antenna else looks()
    got = fringe_bound(n, inward, normal, source, observer)
    wanted = np.zeros(count)
    for i, wedge in enumerate(wedges):
        bases = []
        for u in (source[i], observer[i]):
            side = np.cross(edge[i], u) / np.linalg.norm(np.cross(edge[i], u))
            bases.append((side, np.cross(u, side)))
        u, v = source[i], observer[i]
        both = [
            [
                0.5 * (theory.fringe_strip(wedge, u, v, e, q) + theory.fringe_strip(wedge, v, u, q, e))
                for q in bases[1]
            ]
            for e in bases[0]
        ]
        wanted[i] = np.sqrt(np.pi) * np.linalg.norm(both, 2)
    wedge = n < 2.0
    # tol: the theory's differences of large numbers near the boundaries, where it has no series
    assert np.abs(got / wanted - 1.0)[wedge].max() < 1e-6
    assert (got[~wedge] > 0.999 * wanted[~wedge]).all()


def test_a_right_angle_seen_from_inside_and_a_plane_have_no_fringe() -> None:
    """Images solve both exactly: the whole current is the optical one, so that concave corners need none."""
    soft, hard = theory.fringe_coefficients(1.0 + 1e-9, np.array([0.5, 2.0]), np.array([1.0, 2.5]))
    assert np.abs(soft).max() < 1e-6 and np.abs(hard).max() < 1e-6
    # of N = 1/2 the far field of the edge itself is none
    soft, hard = theory.wedge_coefficients(0.5, 0.4, 1.1)
    assert abs(soft) < 1e-12 and abs(hard) < 1e-12


def test_the_plate_is_optics_and_the_fringes_of_two_rims() -> None:
    width, height, wavelength = 0.4, 1.0, 0.1
    for angle in (0.1, 0.5, 1.0, 1.4):
        look = np.array([np.sin(angle), 0.0, np.cos(angle)])
        k = 2.0 * np.pi / wavelength
        levels = theory.plate_with_edges(width, height, wavelength, angle)
        for e, want in zip(([0.0, 1.0, 0.0], np.cross([0.0, 1.0, 0.0], look)), levels, strict=True):
            total = complex(theory.plate_amplitude(width, height, wavelength, np.sin(angle)))
            for side in (1.0, -1.0):
                rim = theory.WedgeFrame(2.0, np.array([-side, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
                shift = np.exp(1j * k * side * width * np.sin(angle))
                total += height * theory.fringe_strip(rim, look, look, e, e) * shift
            assert abs(total) ** 2 == pytest.approx(float(want), rel=1e-6)


class Strip:
    """Strip solved by the method of moments: electric field integral equation, in wavelengths."""

    def __init__(self, width: float, n: int) -> None:
        self.k, self.h = 2.0 * np.pi, width / n
        self.x = (np.arange(n) + 0.5) * self.h - 0.5 * width
        d = np.abs(self.x[:, None] - self.x)
        self.kernel = np.where(d > 0, hankel2(0, self.k * np.where(d > 0, d, 1.0)), 0.0)
        near = 1.0 - 2j / np.pi * np.log(1.781072418 * self.k * self.h / 2.0)
        i = np.arange(n - 1)
        self.kernel[np.diag_indices(n)] = near + 3j / np.pi  # mean of ln |x - x'| over a cell: ln h - 3/2
        change = 2j / np.pi * (1.5 - 2.0 * np.log(2.0))  # over neighbours: ln h + 2 ln 2 - 3/2
        self.kernel[i, i + 1] += change
        self.kernel[i + 1, i] += change

        self.current, charge = np.zeros((n, n - 1)), np.zeros((n, n - 1))
        self.current[i, i] = self.current[i + 1, i] = 0.5
        charge[i, i], charge[i + 1, i] = 1.0 / self.h, -1.0 / self.h
        cells = self.kernel * self.h**2
        across = 0.25 * self.k * self.current.T @ cells @ self.current
        self.along = np.linalg.inv(0.25 * self.k * self.kernel * self.h)
        self.across = np.linalg.inv(across - charge.T @ cells @ charge / (4.0 * self.k))

    def levels(self, angle: float) -> tuple[float, float]:
        """RCS of a strip cut off at one wavelength, field along and across its edges, square wavelengths."""
        wave = np.exp(1j * self.k * self.x * np.sin(angle))
        drive = self.current.T @ wave * np.cos(angle) * self.h
        along, across = wave @ self.along @ wave * self.h, drive @ self.across @ drive
        # 2 L^2 / lambda of the scattering width k |F|^2 / 4
        return 0.5 * self.k * abs(along) ** 2, 0.5 * self.k * abs(across) ** 2


@pytest.fixture(scope="module")
def strip() -> Strip:
    return Strip(4.0, 160)


def test_the_multiply_diffracted_plate_is_the_solved_strip(strip: Strip) -> None:
    """Tilts up to 60 degrees; singly diffracted, the field along the edges is right up to edge-on."""
    edge_on = np.sqrt(theory.edge_on_rcs(1.0))
    for degrees, single in ((20.0, False), (33.0, False), (57.0, False), (75.0, True), (89.0, True)):
        angle = np.radians(degrees)
        exact = np.sqrt(strip.levels(angle)) / edge_on
        got = np.sqrt(theory.plate_with_edges(4.0, 1.0, 1.0, angle, order=1 if single else 2)) / edge_on
        # tol: waves between the edges are those of half planes; cells a fortieth of a wavelength wide, with which the
        # current across the edges converges slowly (0.05 from twice as many)
        assert abs(got[0] - exact[0]) < 0.03
        assert single or abs(got[1] - exact[1]) < 0.2


@pytest.mark.parametrize("seed", range(3))
def test_waves_between_the_rims_of_drawn_strips(seed: int) -> None:
    """Field across the rims, strips of drawn widths from near the normal to edge-on, against the method of moments."""
    rng = np.random.default_rng(200 + seed)
    width = (rng.uniform(1.0, 1.6), rng.uniform(1.6, 4.0), rng.uniform(4.0, 6.0))[seed]
    angle = np.radians(rng.uniform(1.0, 89.5, 60))
    # a strip returns 2 b^2 / lambda of its scattering width; edge-on amplitude b / sqrt(pi)
    exact = np.abs(strips_by_moments([[(0.0, -width / 2), (0.0, width / 2)]], 1.0, angle)[1]) * np.sqrt(
        2.0 * np.pi
    )
    double, single = (
        np.sqrt(np.pi * closed(width, 1.0, 1.0, angle)[1]) - exact
        for closed in (theory.plate_along_its_sheet, theory.plate_with_edges)
    )
    # tol: waves that pass more than three times between the rims, 1/8 pi^2 a^2 of the single wave and less
    assert np.sqrt(np.mean(double**2)) < 0.05
    assert np.sqrt(np.mean(single**2)) > 8.0 * np.sqrt(np.mean(double**2))


def test_edge_on_a_sheet_returns_nothing_across_its_rims() -> None:
    assert theory.plate_along_its_sheet(4.0, 1.0, 1.0, 0.5 * np.pi)[1] < 1e-12
    along = theory.plate_along_its_sheet(4.0, 1.0, 1.0, 1.3)[0]
    assert along == pytest.approx(float(theory.plate_with_edges(4.0, 1.0, 1.0, 1.3)[0]), rel=1e-6)


def test_edge_on_level() -> None:
    along = theory.plate_with_edges(0.3, 2.0, 0.1, 0.5 * np.pi)[0]
    assert along == pytest.approx(float(theory.edge_on_rcs(2.0)))
