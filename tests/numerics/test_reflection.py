"""Fresnel reflection where formulas lose digits: grazing, normal, Brewster and critical angles, extreme materials."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.tracing.kernel import field
from sarmitsuba.truth.validation.targets import PEC, geometry, parallelogram, plate
from tests.support.paths import aimed_at, coherent_flags, record_paths

FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY


def exact(cos_theta: np.ndarray, chi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """r_TE, r_TM in extended precision, as textbooks write them."""
    c = cos_theta.astype(np.longdouble)
    eps = 1 + chi.astype(np.clongdouble)
    q = np.sqrt(chi.astype(np.clongdouble) + c * c)
    q = np.where(q.imag > 0, -q, q)
    return (c - q) / (c + q), (eps * c - q) / (eps * c + q)


def in_kernel(cos_theta: np.ndarray, chi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """r_TE, r_TM by the kernel's float32 function."""
    ensure_backend()
    x = mi.Complex2f(mi.Float(chi.real.astype(np.float32)), mi.Float(chi.imag.astype(np.float32)))
    te, tm = field.fresnel(mi.Float(cos_theta.astype(np.float32)), x)
    return te.real.numpy() + 1j * te.imag.numpy(), tm.real.numpy() + 1j * tm.imag.numpy()


def textbook(cos_theta: np.ndarray, chi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """r_TE, r_TM by the textbook quotients in float32."""
    c, eps = cos_theta.astype(np.float32), (np.complex64(1) + chi.astype(np.complex64))
    q = np.sqrt(eps - (1 - c * c))
    q = np.where(q.imag > 0, -q, q)
    return (c - q) / (c + q), (eps * c - q) / (eps * c + q)


def worst(got: tuple[np.ndarray, np.ndarray], truth: tuple[np.ndarray, np.ndarray]) -> float:
    """Largest relative error of both coefficients, away from the Brewster zero."""
    out = 0.0
    for g, t in zip(got, truth, strict=True):
        usual = np.abs(t) > 0.05 * np.abs(truth[0])
        out = max(out, float((np.abs(g - t) / np.abs(t))[usual].max()))
    return out


def test_coefficients_keep_their_digits(row) -> None:
    """All permittivities from 1 + 1e-6 to a metal's, all angles to 89.99 degrees.

    Naive way: (c - q) / (c + q) in float32 loses everything where eps is near 1, or near grazing.
    """
    theta = np.radians(np.concatenate([np.linspace(0.0, 89.9, 200), [89.95, 89.99]]))
    chi = np.concatenate(
        [10.0 ** np.arange(-6.0, 9.0), [2.5 - 0.1j, 4.2 - 1.0j, 24.0 - 8.0j, -1e3j, -1e7j, -1e9j, -1e18j]]
    )
    c, x = (a.ravel() for a in np.meshgrid(np.cos(theta).astype(np.float32), chi.astype(np.complex64)))
    truth = exact(c, x)
    row(
        "Fresnel coefficients, 0 to 89.99 degrees, eps - 1 from 1e-6 to 1e18: relative error",
        worst(in_kernel(c, x), truth),
        1e-5,
        naive=worst(textbook(c, x), truth),
        remedy="differences multiplied out, eps - 1 carried in place of eps",
    )


def test_brewster_angle_reflects_nothing(row) -> None:
    """r_TM at tan(theta) = sqrt(eps)."""
    eps = np.array([1.001, 2.0, 4.0, 10.0, 80.0, 1e4])
    c = 1.0 / np.sqrt(1.0 + eps)
    # tol: float32 of the angle itself moves |r| by a few 1e-7 per unit of eps' slope
    truth = np.abs(exact(c.astype(np.float32), (eps - 1).astype(np.complex64))[1])
    got = np.abs(in_kernel(c, eps - 1 + 0j)[1])
    # the textbook's quotient does as well here: its difference of equals leaves 5e-8
    row("|r_TM| at the Brewster angle, eps 1.001 to 1e4", float(np.max(got - truth)), 1e-7)


def test_total_reflection_beyond_the_critical_angle(row) -> None:
    """Into a thinner medium (eps 0.5; no scene file allows it) |r| = 1 beyond 45 degrees, below 1 before."""
    theta = np.radians(np.concatenate([np.linspace(0, 44.9, 50), [45.0], np.linspace(45.1, 89.99, 50)]))
    te, tm = in_kernel(np.cos(theta), np.full(theta.shape, -0.5 + 0j))
    assert np.isfinite(te).all() and np.isfinite(tm).all()
    assert (np.abs(te[:50]) < 1).all() and (np.abs(tm[:50]) < 1).all()
    beyond = np.concatenate([np.abs(te[51:]), np.abs(tm[51:])])
    row("|r| - 1 beyond the critical angle", float(np.abs(beyond - 1).max()), 1e-6)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    real=st.floats(0.0, 9.0),
    imag=st.floats(-12.0, 12.0),
)
def test_no_surface_reflects_more_than_arrives(seed: int, real: float, imag: float) -> None:
    """|R| <= 1 for 2000 random angles of any eps' - j eps'' that a file can hold."""
    rng = np.random.default_rng(seed)
    c = np.concatenate([rng.random(1000), 10.0 ** rng.uniform(-7, 0, 1000)])
    chi = np.full(c.shape, 10.0**real - 1.0 - 1j * 10.0**imag)
    for r in in_kernel(c, chi):
        assert np.isfinite(r).all()
        assert np.abs(r).max() <= 1.0 + 1e-6  # tol: float32 rounding


def test_normal_incidence_needs_no_plane(row) -> None:
    """Rays exactly along the normal: finite fields, the same for every choice of the plane of incidence.

    Naive way: h = d x n / |d x n| is 0 / 0.
    """
    ensure_backend()
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(2000, 3))
    normals[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    normals = (normals / np.linalg.norm(normals, axis=1)[:, None]).astype(np.float32)
    n = mi.Vector3f(np.ascontiguousarray(normals.T))
    d = -n
    x = mi.Vector3f(np.ascontiguousarray(rng.normal(size=(3, 2000)).astype(np.float32)))
    e = (x - n * dr.dot(x, n), dr.zeros(mi.Vector3f, 2000))  # any field across the ray
    r_te, r_tm = field.fresnel(mi.Float(1.0), mi.Complex2f(4.2, -1.0))
    h = field.incidence_basis(d, n)
    results = []
    for basis in (h, dr.cross(d, h)):
        out = field.reflect_field(e, d, n, basis, r_te, r_tm)
        results.append(np.array(out[0]) + 1j * np.array(out[1]))
    naive = np.array(dr.cross(d, n) / dr.norm(dr.cross(d, n)))
    assert np.isnan(naive[:, :6]).all()  # elsewhere it is rounding noise, along d as likely as across
    row(
        "field reflected at normal incidence: change with the choice of the plane, relative",
        float(np.abs(results[0] - results[1]).max() / np.abs(results[0]).max()),
        1e-6,
        naive=float("nan"),
        remedy="any direction across the ray where d x n vanishes",
    )
    # and through the kernel: a dielectric plate seen exactly along its normal
    glass = (Material("glass", permittivity=6.3 - 0.1j),)
    look = [[0.0, 0.0, 1.0], [1e-7, 0.0, 1.0], [1e-5, 1e-5, 1.0]]
    amplitude = monostatic_rcs(plate(0.5, 0.5), glass, look, FREQUENCY, max_depth=1).amplitude[:, 0]
    metal = monostatic_rcs(plate(0.5, 0.5), PEC, look, FREQUENCY, max_depth=1).amplitude[:, 0]
    reflection = abs(exact(np.ones(1), np.array([5.3 - 0.1j]))[0][0])
    np.testing.assert_allclose(np.abs(amplitude / metal), float(reflection), rtol=1e-5)  # tol: float32


def test_grazing_double_bounce(row) -> None:
    """Concrete ground at 80 to 89.9 degrees in front of a metal wall: ground-wall bounce over direct return.

    HH and VV must be the ground's own Fresnel coefficients; at 89.9 degrees the ray's cosine is 0.0017. The mean of
    both chains, over the ground and over the wall: they are two estimates of one return, and share it.
    """
    concrete = Material("concrete", permittivity=5.24 - 0.5j)
    length = 50.0
    scene = geometry(
        [
            parallelogram([0, -1, 0], [length, 0, 0], [0, 2, 0]),
            parallelogram([length, -1, 0], [0, 2, 0], [0, 0, 10.0]),
        ],
        [0, 1],
    )
    worst_error = 0.0
    for grazing_deg in (10.0, 2.0, 0.5, 0.1):
        e = np.radians(grazing_deg)
        antenna = np.array([length, 0.0, 0.0]) + 1e6 * np.array([-np.cos(e), 0.0, np.sin(e)])
        # rays to one height of the wall: directly, by way of the ground, and on to the ground
        height = 0.2 * length * np.tan(e) * np.linspace(0.3, 1.0, 50)
        direct = np.stack([np.full(50, length), np.zeros(50), height], axis=1)
        ground = np.stack([length - height / np.tan(e), np.zeros(50), np.zeros(50)], axis=1)
        truth = exact(np.array([np.sin(e)]), np.array([4.24 - 0.5j]))
        for channel, r in zip(("HH", "VV"), truth, strict=True):
            values = []
            for points, order in ((direct, 0), (ground, 1), (direct, 1)):
                frame, grid = aimed_at(points, antenna)
                paths = record_paths(
                    scene,
                    (concrete, *PEC),
                    antenna,
                    frame,
                    grid,
                    FREQUENCY,
                    channel=channel,
                    flags=coherent_flags((concrete, *PEC), (channel,), 2, tube_phase=False),
                )
                a = paths.amplitude[order]
                assert np.isfinite(a).all() and a.size == 50
                values.append(a / grid.spacing**2)  # each grid has tubes of its own
            assert (np.abs(values[0]) > 0).all() and (np.abs(values[1] + values[2]) > 0).all()
            ratio = np.abs(0.5 * np.mean(values[1] + values[2]) / np.mean(values[0]))
            worst_error = max(worst_error, abs(ratio / float(np.abs(r[0])) - 1.0))
    row("ground-wall bounce at 80 to 89.9 degrees incidence: relative error", float(worst_error), 1e-4)
