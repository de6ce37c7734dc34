"""Closed forms against published figures and against each other."""

import numpy as np
import pytest
from scipy.integrate import quad

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.diffuse import diffuse_tables
from sarmitsuba.scene.materials.fresnel import fresnel
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.truth import theory

# 10 wavelengths
SIDE, WAVELENGTH = 0.3, 0.03


def sph(azimuth: float, elevation: float) -> np.ndarray:
    return np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )


# ---------------------------------------------------------------- Fresnel


def test_fresnel_lossless_values() -> None:
    # reference: eps = 5.24
    rows = [
        (0, -0.39193177903211346, 0.3919317790321135),
        (20, -0.4132608904816172, 0.3701728537160361),
        (45, -0.5096790415877052, 0.2597727254337617),
        (66.4, -0.6794686202231148, 3.447692133212705e-05),
        (70, -0.7184275058845598, -0.07607943855711598),
        (85, -0.9188541406153385, -0.6372067391903782),
        (89.9, -0.9983062234972434, -0.9911563668980027),
    ]
    for angle, te, tm in rows:
        r_te, r_tm = theory.fresnel(np.cos(np.radians(angle)), 5.24)
        # tol: float64 rounding
        assert complex(r_te) == pytest.approx(te, abs=1e-13)
        assert complex(r_tm) == pytest.approx(tm, abs=1e-13)


def test_fresnel_concrete() -> None:
    # ITU-R P.2040-3 concrete at 9.6 GHz
    te, tm = theory.fresnel(np.cos(np.radians(35.0)), 5.24 - 0.5074283209990825j)
    assert complex(te) == pytest.approx(-0.4615238664879536 + 0.02026446162810792j, abs=1e-13)
    assert complex(tm) == pytest.approx(0.3200622879093319 - 0.020225076773948605j, abs=1e-13)


def test_fresnel_near_conductor() -> None:
    eps = 1.0 - 17975103.584522344j
    te, tm = theory.fresnel(np.cos(np.radians([0.0, 89.9])), eps)
    # tol: the difference 1 - |R|^2 keeps 13 of 16 digits
    assert 1.0 - abs(te[0]) ** 2 == pytest.approx(0.0006669057158622538, rel=1e-11)
    assert tm[1] == pytest.approx(0.811767859438024 - 0.1580297523022013j, abs=1e-12)
    for conductivity in (1e12, 1e18):
        te, tm = theory.fresnel(np.array([1.0, 0.5, 0.1]), 1.0 - 1j * conductivity)
        # tol: 4 / |sqrt(eps) cos|
        np.testing.assert_allclose([te, tm], [[-1.0] * 3, [1.0] * 3], atol=100.0 / np.sqrt(conductivity))


def test_fresnel_limits() -> None:
    c = np.concatenate([[0.0], np.logspace(-12, 0, 60)])
    for eps in (1.0, 1.0 + 1e-12, 1.0 - 1e-9j, 0.19, 2.0, 5.24 - 0.5j, 80.0 - 40.0j, 1.0 - 1e9j):
        for r in theory.fresnel(c, eps):
            assert np.all(np.isfinite(r))
            assert np.all(np.abs(r) <= 1.0 + 1e-15)  # tol: float64 rounding
    te, tm = theory.fresnel(c, 1.0)
    np.testing.assert_allclose([te, tm], 0.0, atol=1e-15)  # tol: the root of c^2
    te, tm = theory.fresnel(0.0, 5.0 - 1.0j)
    np.testing.assert_allclose([te, tm], -1.0, atol=1e-15)  # grazing: -1 for both; tol: rounding
    te, tm = theory.fresnel(1.0, 1.0 + 1e-12)  # the plain difference of square roots keeps 4 digits here
    assert complex(tm) == pytest.approx(2.5e-13, rel=1e-3)  # tol: 1 + 1e-12 itself has 4 digits
    # total reflection from inside the denser medium beyond its critical angle
    angle = np.radians([25.9, 25.91, 60.0])
    assert 25.9 < np.degrees(np.arcsin(1.0 / np.sqrt(5.24))) < 25.91
    te, tm = theory.fresnel(np.cos(angle), 1.0 / 5.24)
    np.testing.assert_allclose(np.abs([te[1:], tm[1:]]), 1.0, atol=1e-14)  # tol: rounding
    assert abs(te[0]) < 1.0 and np.all(theory.normal_wavenumber(np.cos(angle), 1.0 / 5.24).imag <= 0.0)


def test_fresnel_leaves_what_goes_through() -> None:
    """1 - |R|^2 is the normal power flow of the refracted wave, whose fields the boundary conditions give."""
    c = np.linspace(0.01, 1.0, 100)
    for eps in (2.0, 5.24 - 0.507j, 62.0 - 32.0j, 1.0 - 1e3j):
        q = theory.normal_wavenumber(c, eps)
        te, tm = theory.fresnel(c, eps)
        # tol: float64 rounding
        np.testing.assert_allclose(1 - abs(te) ** 2, abs(1 + te) ** 2 * q.real / c, rtol=1e-9, atol=1e-14)
        np.testing.assert_allclose(
            1 - abs(tm) ** 2, abs(1 + tm) ** 2 * (q / eps).real / c, rtol=1e-9, atol=1e-14
        )


def test_fresnel_of_the_package_is_the_same_law() -> None:
    """Two derivations that share no line: admittances here, analytic differences in ``materials``."""
    c = np.concatenate([[0.0, 1e-6, 1e-3], np.linspace(0.01, 1.0, 397)])
    for eps in (1.0, 1.5, 4.0, 0.19, 5.24 - 0.507j, 15.0 - 3.0j, 62.0 - 32.0j, 1.0 - 1.8e7j):
        for ours, theirs in zip(theory.fresnel(c, eps), fresnel(c, eps), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-13)  # tol: float64 rounding


# ---------------------------------------------------------------- rough surfaces


def test_small_perturbation_published() -> None:
    # reference: 5.405 GHz, s = 2 mm, l = 6 cm, eps = 15 - 3j, exponential; hh and vv, dB
    rows = {
        20: (-12.865086816709269, -11.36050285787736),
        30: (-18.74823541549841, -15.524147164304198),
        40: (-23.650872421261283, -18.211378431034714),
        50: (-28.405358225420564, -20.286688202114675),
    }
    k = 2.0 * np.pi * 5.405e9 / SPEED_OF_LIGHT
    sigma = theory.small_perturbation_sigma0(np.radians(list(rows)), 15.0 - 3.0j, k, 2e-3, 0.06)
    np.testing.assert_allclose(db_from_power(sigma).T, list(rows.values()), atol=1e-6)  # tol: quadrature


def test_kirchhoff_published() -> None:
    # reference: rms slope 0.2, eps = 15 - 3j, dB
    rows = {0: 6.453047083356504, 10: 5.031146426115752, 20: 0.3420055338077026, 30: -9.143781597112985}
    reflectivity = abs(theory.fresnel(1.0, 15.0 - 3.0j)[0]) ** 2
    for angle, level in rows.items():
        sigma = theory.kirchhoff_sigma0(
            np.radians(angle), np.pi / 2, 1.0, 0.2, np.sqrt(2.0), reflectivity, "geometrical_optics"
        )
        assert float(db_from_power(sigma)) == pytest.approx(level, abs=1e-9)  # tol: float64 rounding


def test_integral_equation_meets_small_perturbation() -> None:
    """For small heights both are the same first order."""
    theta = np.radians([15.0, 30.0, 60.0])
    iem = theory.integral_equation_sigma0(theta, 15.0 - 3.0j, 1.0, 1e-3, 2.0)
    spm = theory.small_perturbation_sigma0(theta, 15.0 - 3.0j, 1.0, 1e-3, 2.0)
    np.testing.assert_allclose(iem, spm, rtol=2e-4)  # tol: next order, (k s)^2, and the transition's


@pytest.mark.parametrize("law", ["small_perturbation", "iem", "roughness", "kirchhoff"])
def test_tables_of_the_package_are_the_same_laws(law: str) -> None:
    """Two programs of each law: series, quadratures and published coefficients here, closed forms in ``materials``."""
    degrees = np.array([0.0, 5.0, 20.0, 45.0, 70.0])
    s, length = {"small_perturbation": (0.001, 0.03), "kirchhoff": (0.02, 0.141)}.get(law, (0.004, 0.04))
    material = Material(
        "soil", permittivity=15.0 - 3.0j, diffuse_law=law, rms_height=s, correlation_length=length
    )
    k, theta = 2.0 * np.pi / WAVELENGTH, np.radians(degrees)
    if law == "small_perturbation":
        closed = theory.small_perturbation_sigma0(theta, material.permittivity, k, s, length)
    elif law == "iem":
        closed = theory.integral_equation_sigma0(theta, material.permittivity, k, s, length)
    elif law == "roughness":
        closed = theory.shared_energy_sigma0(theta, material.permittivity, k * s)
    else:
        r2 = abs(theory.fresnel(1.0, material.permittivity)[0]) ** 2
        same = [
            theory.kirchhoff_sigma0(t, np.pi / 2, WAVELENGTH, s, length, r2, "geometrical_optics")
            for t in theta
        ]
        closed = (np.asarray(same), np.asarray(same))
    # 0.1 degrees apart: every angle is a node
    table = diffuse_tables(material, WAVELENGTH, 901).sigma0(theta)
    np.testing.assert_allclose(db_from_power(table), db_from_power(closed), atol=1e-4)  # tol: quadratures


# ---------------------------------------------------------------- sphere


@pytest.mark.parametrize(
    ("ka", "mie", "po"),
    [
        (0.1, 0.0008983365971522708, 0.009977799987306286),
        (1.0, 3.6375665428517023, 0.7987759914478896),
        (5.0, 1.1688370491183557, 1.1455856527594028),
        (21.1, 0.9582480375315392, 1.0476961241705183),
        (64.4, 1.0012869799656796, 1.0001588364740632),
        (200.0, 0.9999171214793651, 1.0042736630024294),
    ],
)
def test_sphere(ka: float, mie: float, po: float) -> None:
    # tol: float64 rounding of the recurrences
    assert float(theory.sphere_mie(ka)) == pytest.approx(mie, rel=1e-11)
    assert float(theory.sphere_po(ka)) == pytest.approx(po, rel=1e-12)
    radius = ka * WAVELENGTH / (2.0 * np.pi)
    amplitude = theory.sphere_po_amplitude(radius, WAVELENGTH)
    assert abs(amplitude) ** 2 == pytest.approx(np.pi * radius**2 * po, rel=1e-9)


def test_sphere_mie_agrees_with_miepython() -> None:
    miepython = pytest.importorskip("miepython", reason="cross-check needs the test extra")
    x = np.array([0.5, 2.0, 20.0, 35.5, 60.0, 100.0])
    with np.errstate(all="ignore"):
        *_, q_back, _ = (np.asarray(v) for v in miepython.efficiencies_mx(-10000j + 0.0, x))
    # tol: a refractive index of 10000 j is not infinite: |r| = 1 but its phase is off by 2e-4 rad
    np.testing.assert_allclose(theory.sphere_mie(x), q_back, rtol=2e-3)


def test_sphere_po_ripple() -> None:
    ka = np.linspace(20.0, 30.0, 20001)
    level = db_from_power(theory.sphere_po(ka))
    # reference: dB; tol: sampling of the extrema
    assert level.min() == pytest.approx(-0.19079686851142175, abs=1e-6)
    assert level.max() == pytest.approx(0.20495480009154482, abs=1e-6)


# ---------------------------------------------------------------- plate, disc, cylinder


def test_plate() -> None:
    reference = {
        0: 20.53452373461421,
        1: 18.716831185246036,
        2.5: 3.5959758470721255,
        5: 2.9054628335546147,
        10: -0.3868184502106907,
        45: -22.722608588848054,
    }
    for angle, level in reference.items():
        sigma = theory.plate_rcs(SIDE, SIDE, WAVELENGTH, np.radians(angle))
        # tol: float64 rounding in the sidelobes
        assert float(db_from_power(sigma)) == pytest.approx(level, abs=1e-9)
    assert theory.plate_rcs(SIDE, SIDE, WAVELENGTH, np.radians(30.0)) < 1e-25  # a null


def _surface_integral(function: object, low: float, high: float) -> complex:
    real = quad(lambda t: np.real(function(t)), low, high, limit=400)[0]  # type: ignore[operator]
    imag = quad(lambda t: np.imag(function(t)), low, high, limit=400)[0]  # type: ignore[operator]
    return complex(real, imag)


@pytest.mark.parametrize("angle", [0.0, 1.0, 4.0, 10.0])
def test_disc_is_the_surface_integral(angle: float) -> None:
    k, theta, radius = 2.0 * np.pi / WAVELENGTH, np.radians(angle), 0.15
    field = _surface_integral(
        lambda x: 2.0 * np.sqrt(radius**2 - x * x) * np.exp(2j * k * x * np.sin(theta)), -radius, radius
    )
    sigma = 4.0 * np.pi / WAVELENGTH**2 * abs(field * np.cos(theta)) ** 2
    # tol: quadrature of the square root's ends, 1e-8 of the peak
    assert float(theory.disc_rcs(radius, WAVELENGTH, theta)) == pytest.approx(sigma, rel=1e-4)


@pytest.mark.parametrize("angle", [0.0, 2.0, 5.0])
def test_cylinder_is_the_surface_integral(angle: float) -> None:
    k, psi, radius, height = 2.0 * np.pi / WAVELENGTH, np.radians(angle), 0.2, 0.3
    around = _surface_integral(
        lambda a: radius * np.cos(a) * np.exp(2j * k * radius * np.cos(a) * np.cos(psi)),
        -np.pi / 2,
        np.pi / 2,
    )
    along = height * np.sinc(k * height * np.sin(psi) / np.pi)
    sigma = 4.0 * np.pi / WAVELENGTH**2 * abs(around * along * np.cos(psi)) ** 2
    exact = float(theory.cylinder_rcs(radius, height, WAVELENGTH, psi, exact=True))
    assert exact == pytest.approx(sigma, rel=1e-7)  # tol: quadrature
    # tol: the edge term of the shadow boundary, 2 / sqrt(pi k r) of the field with k r = 42
    near = db_from_power(theory.cylinder_rcs(radius, height, WAVELENGTH, psi))
    assert float(near) == pytest.approx(float(db_from_power(exact)), abs=1.5)
    broadside = 2.0 * np.pi * radius * height**2 / WAVELENGTH
    assert float(theory.cylinder_rcs(radius, height, WAVELENGTH)) == pytest.approx(broadside)


# ---------------------------------------------------------------- corners


@pytest.mark.parametrize(
    ("azimuth", "vv", "hh", "phase"),
    [
        (0.0, 20.534523734614215, 20.534523734614215, 0.0),
        (15.0, 14.30706187806977, 15.267315089031698, -175.6587724818753),
        (35.0, 21.685171375160014, 21.772866359014927, -176.76237988544142),
    ],
)
def test_dihedral_over_azimuth(azimuth: float, vv: float, hh: float, phase: float) -> None:
    """Corner line vertical, so VV is the field along it; the reference summed rays for the double bounce."""
    d = theory.dihedral(SIDE, SIDE, SIDE, WAVELENGTH, np.radians(azimuth))
    # tol: the reference's own ray sum, 14.794 for 14.815 dB at 15 degrees
    assert float(db_from_power(np.abs(d.parallel) ** 2)) == pytest.approx(vv, abs=0.025)
    assert float(db_from_power(np.abs(d.perpendicular) ** 2)) == pytest.approx(hh, abs=0.025)
    difference = np.degrees(np.angle(d.perpendicular * np.conj(d.parallel)))
    assert float(difference) == pytest.approx(phase, abs=0.05)


def test_dihedral_levels() -> None:
    closed = {15.0: 14.815048259280616, 35.0: 21.726949674975778, 45.0: 23.544823691254024}
    for azimuth, level in closed.items():
        d = theory.dihedral(SIDE, SIDE, SIDE, WAVELENGTH, np.radians(azimuth))
        assert float(db_from_power(d.double**2)) == pytest.approx(level, abs=1e-9)
    # symmetric about the bisector
    left, right = (theory.dihedral(0.3, 0.3, 0.2, 0.03, a) for a in np.radians([20.0, 70.0]))
    assert complex(left.parallel) == pytest.approx(complex(right.parallel), rel=1e-9)
    # worked example: 1.5 m at 5.405 GHz
    d = theory.dihedral(1.5, 1.5, 1.5, SPEED_OF_LIGHT / 5.405e9, np.pi / 4)
    assert float(db_from_power(d.double**2)) == pytest.approx(46.16554886631605, abs=1e-9)


def test_rolled_dihedral_is_a_rotated_one() -> None:
    flat = theory.rolled_dihedral(2.0, 0.0)
    np.testing.assert_allclose(flat, [[-2.0, 0.0], [0.0, 2.0]])
    tau = np.radians(22.5)
    turned = theory.rolled_dihedral(2.0, tau)
    assert abs(turned[0, 0]) == pytest.approx(abs(turned[0, 1]))  # HH = HV at 22.5 degrees
    rotation = np.array([[np.cos(tau), -np.sin(tau)], [np.sin(tau), np.cos(tau)]])
    np.testing.assert_allclose(turned, rotation @ flat @ rotation.T, atol=1e-15)


def test_trihedral_peaks() -> None:
    bore = np.ones(3) / np.sqrt(3.0)
    cases = [
        (1.5, 3e8 / 3e9, "triangular", 33.26453645525159),
        (2.5, SPEED_OF_LIGHT / 5.405e9, "triangular", 47.25798634713388),
        (1.0, SPEED_OF_LIGHT / 9.65e9, "triangular", 36.37501830134164),
        (6 * 0.0254, SPEED_OF_LIGHT / 10e9, "square", 13.546295809002304),
    ]
    for edge, wavelength, shape, level in cases:
        sigma = theory.trihedral_rcs(edge, wavelength, bore, shape)  # type: ignore[arg-type]
        # tol: 3e8 for c in the published examples
        assert float(db_from_power(sigma)) == pytest.approx(level, abs=0.007)


@pytest.mark.parametrize("shape", ["triangular", "square"])
@pytest.mark.parametrize(("azimuth", "elevation"), [(45.0, 35.264), (40.0, 25.0), (20.0, 30.0), (70.0, 10.0)])
def test_trihedral_area_is_the_overlap_with_its_inversion(
    shape: str, azimuth: float, elevation: float
) -> None:
    """Rationale: rays that bounce three times hit the aperture and its image through the corner."""
    look = sph(np.radians(azimuth), np.radians(elevation))
    across = np.cross(look, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, look)
    axes = np.eye(3) @ np.stack([across, up], axis=1)
    if shape == "triangular":
        outline = axes
    else:
        x, y, z = axes
        outline = np.array([x, x + y, y, y + z, z, z + x])
    step = 0.004
    grid = np.arange(-1.5, 1.5, step) + 0.5 * step
    u, v = np.meshgrid(grid, grid)

    def inside(points: np.ndarray, sign: float) -> np.ndarray:
        # star-shaped about the corner: a point is inside when its ray leaves through an edge beyond it
        keep = np.zeros(u.shape, dtype=bool)
        for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
            det = a[0] * b[1] - a[1] * b[0]
            s, t = (sign * (u * b[1] - v * b[0]) / det, sign * (v * a[0] - u * a[1]) / det)
            keep |= (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
        return keep

    area = np.count_nonzero(inside(outline, 1.0) & inside(outline, -1.0)) * step**2
    sigma = float(theory.trihedral_rcs(1.0, WAVELENGTH, look, shape))  # type: ignore[arg-type]
    # tol: pixel counting, outline length x step / area x sqrt of the number of edge pixels
    assert np.sqrt(sigma * WAVELENGTH**2 / (4.0 * np.pi)) == pytest.approx(area, rel=0.01)
    assert float(theory.trihedral_rcs(1.0, WAVELENGTH, -look, shape)) == 0.0  # type: ignore[arg-type]


# ---------------------------------------------------------------- roughness and walls


def test_coherent_loss() -> None:
    reference = {0.05: -0.02914159714246736, 0.3: -1.0490974971288285, 1.0: -11.65663885698698}
    for ks, level in reference.items():
        loss = theory.coherent_loss(ks * WAVELENGTH / (2 * np.pi), WAVELENGTH, np.radians(35.0))
        assert float(db_from_power(loss)) == pytest.approx(level, abs=1e-12)


def test_wall_and_ground() -> None:
    theta = np.radians(40.0)
    h, v = theory.wall_ground_amplitude(3.0, 5.0, 10.0, WAVELENGTH, theta)
    assert complex(v) == -complex(h)  # conductors: a dihedral with its corner line along h
    assert abs(h) == pytest.approx(2 * np.sqrt(np.pi) / WAVELENGTH * 2 * 5.0 * 3.0 * np.sin(theta))
    d = theory.dihedral(3.0, 10.0, 5.0, WAVELENGTH, np.pi / 2 - theta)  # wall is the first face
    assert abs(h) == pytest.approx(float(d.double))
    concrete, soil = 5.24 - 0.507j, 15.0 - 3.0j
    h2, v2 = theory.wall_ground_amplitude(3.0, 5.0, 10.0, WAVELENGTH, theta, concrete, soil)
    te, tm = (
        theory.fresnel(np.sin(theta), concrete)[i] * theory.fresnel(np.cos(theta), soil)[i] for i in (0, 1)
    )
    assert complex(h2 / h) == pytest.approx(complex(te))
    assert complex(v2 / v) == pytest.approx(complex(tm))
    assert abs(v2) < abs(h2)  # one of the two bounces is always near its Brewster angle


def test_ground_models_meet_for_rough_ground() -> None:
    """The series of physical optics becomes geometrical optics; at backscatter that is the diffuse law."""
    for azimuth in (0.0, 0.1, np.pi / 2):
        values = [
            theory.kirchhoff_sigma0(np.radians(20.0), azimuth, 1.0, 20.0, 100.0, 0.3, model)
            for model in ("geometrical_optics", "physical_optics")
        ]
        # tol: next order in 1 / (q_z s)^2 = 1.6e-5, times the exponent
        assert values[1] == pytest.approx(values[0], rel=1e-3)
    m = np.sqrt(2.0) * 20.0 / 100.0
    t = np.tan(np.radians(20.0))
    back = 0.3 * np.exp(-(t**2) / (2 * m * m)) / (2 * m * m * np.cos(np.radians(20.0)) ** 4)
    assert values[0] == pytest.approx(back)


def test_canonical_building() -> None:
    arguments = (10.0, 8.0, np.radians(40.0), 0.031, 0.05, 0.5, 5.0 - 0.5j, 15.0 - 3.0j)
    hh = theory.canonical_building(*arguments, polarisation="hh")
    vv = theory.canonical_building(*arguments, polarisation="vv")
    area = 80.0 * np.tan(np.radians(40.0))
    wall = abs(theory.fresnel(np.sin(np.radians(40.0)), 5.0 - 0.5j)[0]) ** 2
    ground = abs(theory.fresnel(np.cos(np.radians(40.0)), 15.0 - 3.0j)[0]) ** 2
    m2 = 2.0 * 0.1**2
    assert hh.double == pytest.approx(4.0 * wall * ground * area / (2.0 * m2))
    assert hh.triple == pytest.approx(wall**2 * hh.ground * area)
    assert hh.ground == pytest.approx(vv.ground) and hh.double > vv.double
    turned = theory.canonical_building(*arguments, wall_azimuth=np.radians(20.0))
    assert turned.double < hh.double and turned.double_coherent == 0.0
    # smooth ground: all coherent, and equal to the wall-ground dihedral
    smooth = theory.canonical_building(
        10.0, 8.0, np.radians(40.0), 0.031, 1e-6, 0.5, None, None, model="physical_optics"
    )
    h, _ = theory.wall_ground_amplitude(10.0, 8.0, 100.0, 0.031, np.radians(40.0))
    assert smooth.double_coherent == pytest.approx(abs(h) ** 2, rel=1e-6)
    assert smooth.double < 1e-4 * smooth.double_coherent


# ---------------------------------------------------------------- geometry


@pytest.mark.parametrize(
    ("angle", "layover", "slant", "shadow", "shadow_slant", "roof"),
    [
        (20, 54.94954838909245, 18.79385241571817, 7.279404685324047, 21.283555449518243, True),
        (35, 28.562960134842292, 16.383040885779835, 14.004150764194193, 24.41549177522912, True),
        (55, 14.004150764194197, 11.471528727020923, 28.56296013484229, 34.868935912421954, False),
    ],
)
def test_building(
    angle: float, layover: float, slant: float, shadow: float, shadow_slant: float, roof: bool
) -> None:
    b = theory.building_returns(20.0, 15.0, np.radians(angle))
    assert b.layover_ground == pytest.approx(layover)
    assert b.layover_slant == pytest.approx(slant)
    assert b.shadow_ground == b.triple_ground == pytest.approx(shadow)
    assert b.shadow_slant == pytest.approx(shadow_slant)
    assert b.roof_in_layover is roof
    assert b.dihedral_slant == 0.0
    assert b.lit_ground_slant - b.roof_slant[1] == pytest.approx(b.shadow_slant)
    # against explicit points
    look = np.array([np.sin(np.radians(angle)), 0.0, -np.cos(np.radians(angle))])
    top = theory.slant_offset([0.0, 3.0, 20.0], look)
    assert -float(top) == pytest.approx(b.layover_slant)


def test_bridge() -> None:
    for angle, single, ghost in (
        (25, -27.1892336110995, 81.56770083329849),
        (45, -21.213203435596427, 63.63961030678928),
    ):
        b = theory.bridge_returns(30.0, np.radians(angle))
        assert (b.single, b.double, b.triple) == pytest.approx((single, 0.0, -single))
        assert b.under_deck[0] == pytest.approx(ghost)
        assert b.ground_spacing == pytest.approx(30.0 / np.tan(np.radians(angle)))


def test_foreshortening() -> None:
    # flat ground keeps sin(theta); a slope facing the radar more steeply than theta is laid over
    assert theory.foreshortening(0.0, np.radians(30.0)) == pytest.approx(0.5)
    assert theory.foreshortening(np.radians(40.0), np.radians(30.0)) < 0.0


# ---------------------------------------------------------------- statistics and radar equation


def test_speckle_tests_accept_speckle_and_reject_others() -> None:
    rng = np.random.default_rng(1)
    z = (rng.standard_normal(100_000) + 1j * rng.standard_normal(100_000)) / np.sqrt(2.0)
    assert theory.intensity_test(np.abs(z) ** 2, mean=1.0).accepts(0.999)
    assert theory.phase_test(z).accepts(0.999)
    four = np.mean(rng.exponential(size=(4, 100_000)), axis=0)
    assert theory.intensity_test(four, mean=1.0, looks=4.0).accepts(0.999)
    assert not theory.intensity_test(four, mean=1.0).accepts(0.999)
    assert not theory.phase_test(z + 0.1).accepts(0.999)  # a coherent part of -20 dB is seen
    # tol: three standard errors of the ENL, sqrt(8 / n) for one look
    assert theory.equivalent_number_of_looks(np.abs(z) ** 2) == pytest.approx(1.0, abs=3 * np.sqrt(8 / 1e5))
    assert theory.equivalent_number_of_looks(four) == pytest.approx(4.0, rel=0.03)
    assert float(theory.speckle_cdf(np.log(2.0), 1.0)) == pytest.approx(0.5)


def test_radar_equation() -> None:
    # published example: 1 MW, 20 dB antenna, 1 GHz, 1 m^2 at 50 km, 0.2 us, 290 K: 5.5868 dB
    power = theory.received_power(1e6, 100.0, SPEED_OF_LIGHT / 1e9, 1.0, 50e3)
    snr = theory.single_pulse_snr(power, 0.2e-6)
    assert float(db_from_power(snr)) == pytest.approx(5.586805115322827, abs=1e-4)  # tol: digits of k_B
    assert theory.received_power(1e6, 100.0, 0.3, 1.0, 100e3) == pytest.approx(
        theory.received_power(1e6, 100.0, 0.3, 1.0, 50e3) / 16.0
    )
