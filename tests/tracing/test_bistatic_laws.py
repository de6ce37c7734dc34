"""Rough surfaces between two directions, as the kernel has them: perturbation theory, tilted facets, energy.

The references are written here, in the coordinates of the publications or as brute force over random facets, and share
nothing with the kernel but the Fresnel coefficients of ``theory``.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.bsdfs import rough
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.tracing.kernel.scattering_matrix import ScatteringMatrix
from sarmitsuba.tracing.kernel.scene_tables import build_trace_scene
from sarmitsuba.tracing.kernel.table_rows import MaterialRow
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.targets import geometry, parallelogram

FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY
K = 2.0 * np.pi / WAVELENGTH
SOIL = 15.0 - 3.0j
UP = np.array([0.0, 0.0, 1.0])
FLAGS = KernelFlags(channels=("HH", "HV", "VH", "VV"), depolarisation=False)


def patch(half: float = 1.0) -> Geometry:
    """A square on the ground."""
    return geometry([parallelogram([-half, -half, 0], [2 * half, 0, 0], [0, 2 * half, 0])], [0])


def direction(theta: F64, phi: F64) -> F64:
    """Unit vectors upwards from polar angles, rad."""
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def planes(away: F64) -> tuple[F64, F64]:
    """Unit vectors across and in the plane of incidence of upward directions, (n, 3) each."""
    h = np.cross(UP, away)
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    return h, np.cross(h, away)


def kernel_dyad(material: Material, source: F64, out: F64, first: bool = False) -> C128:
    """(n, 2, 2) amplitudes [received, sent] (h, v) of the kernel; both arguments point up from the surface."""
    scene = build_trace_scene(patch(), (material,), WAVELENGTH)

    def vector(v: F64) -> mi.Vector3f:
        return mi.Vector3f(*(mi.Float(np.ascontiguousarray(v[:, i], dtype=np.float32)) for i in range(3)))

    n = source.shape[0]
    row = np.asarray(scene.material_table)[:4]
    hit = SimpleNamespace(
        normal=vector(np.broadcast_to(UP, source.shape)),
        direction=vector(-source),
        material=dr.full(mi.UInt32, int(np.asarray(scene.face_info)[0]), n),
        properties=MaterialRow(mi.Vector4f(*(dr.full(mi.Float, float(x), n) for x in row))),
    )
    matrix = ScatteringMatrix(scene, hit, vector(out), FLAGS, dr.full(mi.Bool, first, n))
    pairs = [(received, sent) for received in planes(out) for sent in planes(source)]
    found = [matrix.between(vector(a), (vector(b), vector(np.zeros_like(b))))[0] for a, b in pairs]
    dr.eval(found)  # one kernel
    values = [np.asarray(value.real) + 1j * np.asarray(value.imag) for value in found]
    return np.stack(values, axis=1).reshape(n, 2, 2).astype(np.complex128)


def angles(n: int, seed: int) -> tuple[F64, F64]:
    """Random pairs of directions above the surface, none within 6 degrees of the vertical or of grazing."""
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(6.0, 84.0, (2, n)))
    phi = rng.uniform(0.0, 2.0 * np.pi, (2, n))
    return direction(theta[0], phi[0]), direction(theta[1], phi[1])


def bistatic_perturbation(eps: complex, s: float, length: float, source: F64, out: F64) -> F64:
    """(n, 2, 2) sigma0 [received, sent] of first-order theory, angle by angle (Ulaby, Moore and Fung, chapter 12)."""
    result = np.empty((source.shape[0], 2, 2))
    for row, (a, b) in enumerate(zip(source, out, strict=True)):
        ci, cs = a[2], b[2]
        si, ss = np.sqrt(1 - ci**2), np.sqrt(1 - cs**2)
        # the wave travels along -a
        phi = np.arctan2(b[1], b[0]) - np.arctan2(-a[1], -a[0])
        qi, qs = np.sqrt(eps - si**2), np.sqrt(eps - ss**2)
        hh = (eps - 1) * np.cos(phi) / ((ci + qi) * (cs + qs))
        vv = (eps - 1) * (qi * qs * np.cos(phi) - eps * si * ss) / ((eps * ci + qi) * (eps * cs + qs))
        hv = (eps - 1) * np.sin(phi) * qi / ((cs + qs) * (eps * ci + qi))
        vh = (eps - 1) * np.sin(phi) * qs / ((eps * cs + qs) * (ci + qi))
        wave = K * np.hypot(*(a + b)[:2])
        spectrum = length**2 / (1 + (wave * length) ** 2) ** 1.5
        level = 8 * K**4 * s**2 * (ci * cs) ** 2 * spectrum
        result[row] = level * np.abs([[hh, hv], [vh, vv]]) ** 2
    return result


@pytest.mark.parametrize("law", ["small_perturbation", "small_slope", "iem"])
@pytest.mark.parametrize("eps", [3.0 - 0.01j, SOIL, 1.0 - 1e7j])
def test_a_slightly_rough_surface_is_first_order_theory_in_every_direction(law: str, eps: complex) -> None:
    """Rationale: what was here, the mean of backscatter at both angles, has no lobe and no phi in it."""
    s, length = 1e-5, 0.02
    material = Material("soil", permittivity=eps, diffuse_law=law, rms_height=s, correlation_length=length)
    source, out = angles(400, 3)
    measured = np.abs(kernel_dyad(material, source, out)) ** 2
    expected = bistatic_perturbation(eps, s, length, source, out)
    floor = 1e-3 * expected.max(axis=(1, 2), keepdims=True)  # channels that vanish at some azimuth
    # tol: interpolation in the table, 0.5 % of the amplitude where the spectrum is steepest, twice for power
    assert np.abs(measured - expected).max(axis=(1, 2)) == pytest.approx(
        np.zeros(400), abs=0.012 * float((expected + floor).max())
    )
    assert np.abs(db_from_power((measured + floor) / (expected + floor))).max() < 0.06


@pytest.mark.parametrize("law", ["small_slope", "iem", "kirchhoff", "lambert", "roughness"])
def test_the_tensor_is_reciprocal_and_its_backscatter_is_the_law(law: str) -> None:
    material = Material(
        "soil",
        permittivity=SOIL,
        diffuse_law=law,
        rms_height=0.008,
        correlation_length=0.08,
        diffuse_level_db=-10.0,
    )
    source, out = angles(300, 5)
    forth, back = kernel_dyad(material, source, out), kernel_dyad(material, out, source)
    top = np.abs(forth).max()
    # tol: float32
    assert np.abs(forth - back.swapaxes(1, 2)).max() < 2e-5 * top
    # the way back along the incoming ray, by the bistatic formula and by the table of the law
    bistatic, table = kernel_dyad(material, source, source), kernel_dyad(material, source, source, first=True)
    power = np.abs(table) ** 2
    # tol: interpolation in both tables, of a lobe
    assert np.abs(bistatic) ** 2 == pytest.approx(power, rel=0.03, abs=1e-6 * power.max())


def test_kirchhoff_is_what_random_facets_mirror() -> None:
    """Brute force: facets of random slope mirror a wave, each with its own Fresnel coefficients; count what arrives.

    Was: |R(0)|^2 at every local angle and the polarisation of the mean plane.
    """
    s, slope = 0.05, 0.15
    material = Material(
        "soil",
        permittivity=SOIL,
        diffuse_law="kirchhoff",
        rms_height=s,
        correlation_length=np.sqrt(2.0) * s / slope,
    )
    rng = np.random.default_rng(8)
    cone = np.cos(np.radians(1.0))
    worst = 0.0
    for source_deg, out_deg, phi_deg in ((40.0, 50.0, 160.0), (60.0, 60.0, 165.0), (30.0, 30.0, 140.0)):
        source = direction(np.radians([source_deg]), np.zeros(1))
        out = direction(np.radians([out_deg]), np.radians([phi_deg]))
        # slopes near the one that mirrors this way; each counts with its density there
        half = (source + out)[0]
        tilt = -half[:2] / half[2] + 0.03 * rng.uniform(-1.0, 1.0, (200_000, 2))
        density = np.exp(-0.5 * np.sum((tilt / slope) ** 2, axis=1)) / (2.0 * np.pi * slope**2) * 0.06**2
        normal = np.column_stack([-tilt, np.ones(len(tilt))])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        cosine = normal @ source[0]
        mirrored = 2.0 * cosine[:, None] * normal - source[0]
        kept = (cosine > 0.0) & (mirrored @ out[0] > cone)
        normal, cosine, mirrored, density = (v[kept] for v in (normal, cosine, mirrored, density))
        te, tm = theory.fresnel(cosine, SOIL)
        across = np.cross(-source[0], normal)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        into, leaving = np.cross(across, -source[0]), np.cross(across, mirrored)
        power = np.empty((2, 2))
        for i, received in enumerate(planes(out)):
            for j, sent in enumerate(planes(source)):
                field = (across @ received[0]) * te * (across @ sent[0])
                field = field + (leaving @ received[0]) * tm * (into @ sent[0])
                power[i, j] = np.sum(density * np.abs(field) ** 2 * cosine / normal[:, 2])
        expected = 4.0 * np.pi * power / (len(tilt) * 2.0 * np.pi * (1.0 - cone))
        measured = np.abs(kernel_dyad(material, source, out)[0]) ** 2
        assert 0.03 < kept.mean() < 0.5 and len(normal) > 6000  # the cone lies within the square of slopes
        strong = expected > 0.01 * expected.max()
        worst = max(worst, np.abs(db_from_power(measured[strong] / expected[strong])).max())
    # tol: some ten thousand facets in the cone (1 %) and the change of the lobe across it
    assert worst < 0.35


@pytest.mark.parametrize("theta_deg", [20.0, 40.0, 60.0])
@pytest.mark.parametrize("phase", [0.3, 0.8])
def test_the_lobe_holds_what_the_coherent_wave_loses(theta_deg: float, phase: float) -> None:
    """Rationale: energy of the coherent wave went evenly into the hemisphere, none of it about the mirror direction.

    Over the hemisphere the law of a gently rough surface returns ``|R|^2 (1 - exp(-(2 k s cos)^2))``.
    """
    material = Material(
        "soil", pec=True, diffuse_law="small_slope", rms_height=phase / K, correlation_length=40.0 / K
    )
    theta = np.radians(theta_deg)
    # quadrature dense about the mirror direction: polar coordinates of the plane of wavenumbers about it
    radius = np.geomspace(1e-4, 2.0, 500)
    turn = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
    r, a = (x.ravel() for x in np.meshgrid(radius, turn, indexing="ij"))
    x, y = np.sin(theta) + r * np.cos(a), r * np.sin(a)
    inside = x**2 + y**2 < 0.9999
    out = np.column_stack([x, y, np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))])[inside]
    source = np.broadcast_to(direction(np.array([theta]), np.array([np.pi]))[0], out.shape)
    power = np.zeros(inside.shape)
    # sent h; d(solid angle) = d^2(k/k0) / cos
    power[inside] = (np.abs(kernel_dyad(material, source, out)[:, :, 0]) ** 2).sum(axis=1) / out[:, 2]
    rings = (power * r).reshape(radius.size, -1).sum(axis=1) * 2.0 * np.pi / turn.size
    total = np.trapezoid(rings * radius, np.log(radius)) / (4.0 * np.pi * np.cos(theta))
    lost = 1.0 - theory.coherent_loss(material.rms_height, WAVELENGTH, theta)
    # tol: an exponential correlation has slopes of every size, whose tail first-order polarisation does not conserve
    assert total == pytest.approx(float(lost), rel=0.08)


def test_facets_and_waves_agree_about_the_mirror_direction() -> None:
    """Rationale: both theories have the same first order in the tilt, cross-polar elements with their signs included.

    So the relative phases of the tensor's elements are checked, which powers do not show.
    """
    angle = np.radians([[50.0, 1.0], [51.0, -1.0], [49.0, 0.5], [50.0, -1.0]])
    source = direction(np.full(4, np.radians(50.0)), np.full(4, np.pi))
    out = direction(angle[:, 0], angle[:, 1])
    tensors = []
    for law, s, length in (("small_perturbation", 1e-4, 0.02), ("kirchhoff", 0.05, 0.7)):
        material = Material(
            "soil", permittivity=SOIL, diffuse_law=law, rms_height=s, correlation_length=length
        )
        tensor = kernel_dyad(material, source, out)
        tensors.append(tensor / tensor[:, :1, :1])
    # tol: second order of a tilt of half a degree, over the cosines: 1e-4 each; the elements are 0.02 and 0.6
    assert tensors[0] == pytest.approx(tensors[1], abs=5e-4)


def test_ordinary_rough_materials_return_vv_above_hh() -> None:
    """Rationale: HH was 8 dB above VV at 45 degrees, and VV 79 dB down at the Brewster angle."""
    for eps in (2.25 - 0.01j, 5.3 - 0.3j, SOIL):
        material = Material(
            "wall",
            permittivity=eps,
            rms_height=1e-3,
            correlation_length=rough(1e-3).correlation_length,
            diffuse_law=rough(1e-3).diffuse_law,
        )
        theta = np.radians(np.arange(10.0, 81.0, 5.0))
        source = direction(theta, np.zeros_like(theta))
        power = np.abs(kernel_dyad(material, source, source, first=True)) ** 2
        hh, vv = theory.small_perturbation_sigma0(theta, eps, K, 1e-3, 1e-2)
        measured, expected = db_from_power(power[:, 1, 1] / power[:, 0, 0]), db_from_power(vv / hh)
        assert (measured > 0.0).all()
        # tol: interpolation of the amplitude on a 0.35 degree grid
        assert measured == pytest.approx(expected, abs=0.02)


def wall_on_ground(off_deg: float) -> Geometry:
    """A metal wall (material 0) that stands on rough ground (material 1), its normal turned about the vertical."""
    off = np.radians(off_deg)
    normal, along = np.array([np.cos(off), np.sin(off), 0.0]), np.array([-np.sin(off), np.cos(off), 0.0])
    wall = parallelogram(-2 * along, 4 * along, 3 * UP)
    ground = parallelogram(-4 * along, 4 * normal, 8 * along)
    return geometry([wall, ground], [0, 1])


def test_a_tilted_facet_behind_a_mirror_turns_the_polarisation() -> None:
    """Wall on rough ground, 20 degrees off aspect: HV at the level of HH, which it left out (-152 dB).

    Rationale: all cells lie in the same two directions of a far antenna, so that channel ratios have no speckle.
    """
    slope, s, theta, off = 0.1, 0.05, np.radians(55.0), 20.0
    ground = Material(
        "ground", pec=True, diffuse_law="kirchhoff", rms_height=s, correlation_length=np.sqrt(2.0) * s / slope
    )
    look = np.array([np.sin(theta), 0.0, np.cos(theta)])
    flags = KernelFlags(
        channels=("HH", "HV", "VV"),
        coherent=False,
        roughness=False,
        depolarisation=False,
        antenna_pattern=False,
        taper=False,
    )
    result = monostatic_rcs(
        wall_on_ground(off),
        (Material("wall", pec=True), ground),
        [look],
        FREQUENCY,
        channels=flags.channels,
        ray_spacing=0.05,
        max_depth=3,  # the way back along the chain counts as the third order
        keep_orders=True,
        flags=flags,
    )
    measured = result.amplitude[0, 1]

    # by hand: down onto the wall, mirrored, onto the facet that sends it home, and the same way reversed
    h = np.cross(-look, UP) / np.linalg.norm(np.cross(-look, UP))
    v = np.cross(h, -look)
    normal = np.array([np.cos(np.radians(off)), np.sin(np.radians(off)), 0.0])
    incoming = -look + 2.0 * (look @ normal) * normal
    facet = look - incoming
    facet /= np.linalg.norm(facet)

    def mirrored(e: F64, n: F64) -> F64:
        return -e + 2.0 * (e @ n) * n

    def channel(sent: F64, received: F64) -> float:
        return float(
            received @ mirrored(mirrored(sent, normal), facet)
            + sent @ mirrored(mirrored(received, normal), facet)
        )

    expected = np.array([channel(h, h), channel(h, v), channel(v, v)])
    assert abs(expected[1] / expected[0]) > 0.5
    # tol: float32, and the spread of directions over the scene seen from a finite distance
    assert measured[1:] / measured[0] == pytest.approx(expected[1:] / expected[0], abs=2e-3)

    # the level, against ground of sigma0 = 1 in every direction, whose random numbers and areas are the same
    even = monostatic_rcs(
        wall_on_ground(off),
        (
            Material("wall", pec=True),
            Material("ground", pec=True, diffuse_law="constant", diffuse_level_db=0.0),
        ),
        [look],
        FREQUENCY,
        channels=("HH",),
        ray_spacing=0.05,
        max_depth=3,  # the way back along the chain counts as the third order
        keep_orders=True,
        flags=replace(flags, channels=("HH",)),
    ).amplitude[0, 1, 0]
    h_in, v_in = (x[0] for x in planes(-incoming[None]))
    h_out, v_out = (x[0] for x in planes(look[None]))
    turned = mirrored(h, normal)
    unit = 2.0 * ((h @ h_out) * (turned @ h_in) + (h @ v_out) * (turned @ v_in))
    tan2 = (facet @ facet) / facet[2] ** 2 - 1.0
    lobe = np.exp(-tan2 / (2.0 * slope**2)) / (2.0 * slope**2 * facet[2] ** 4)
    # tol: linear interpolation of the lobe in the table
    assert abs(measured[0] / even) == pytest.approx(np.sqrt(lobe) * abs(expected[0] / unit), rel=5e-3)


@pytest.mark.parametrize("law", ["small_slope", "iem", "kirchhoff", "roughness", "lambert"])
def test_the_level_of_one_bounce_does_not_depend_on_the_largest_number(law: str) -> None:
    """Rationale: level ground was 12 dB brighter in HH with three bounces than with one."""
    ground = Material(
        "ground",
        permittivity=SOIL,
        diffuse_law=law,
        rms_height=0.004,
        correlation_length=0.05,
        diffuse_level_db=-10.0,
    )
    look = direction(np.radians([55.0]), np.array([0.3]))
    powers = []
    for depth in (1, 3):
        flags = KernelFlags(
            channels=("HH", "VV"),
            coherent=False,
            depolarisation=False,
            antenna_pattern=False,
            taper=False,
            multi_bounce=depth > 1,
        )
        result = monostatic_rcs(
            patch(4.0), (ground,), look, FREQUENCY, ray_spacing=0.1, max_depth=depth, flags=flags
        )
        powers.append(db_from_power(np.abs(result.amplitude[0, 0]) ** 2))
    # tol: float32
    assert powers[1] == pytest.approx(powers[0], abs=1e-3)
