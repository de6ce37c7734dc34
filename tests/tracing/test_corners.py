"""Corners of two facets: where a double bounce is closed, at any angle between them and any roll."""

import numpy as np
import pytest

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.tracing.kernel.source import PointSource
from sarmitsuba.tracing.scatterers.edges.diffraction import FringeCurrents, edges_of
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import full_wave, targets

WAVELENGTH = 0.03
FREQUENCY = SPEED_OF_LIGHT / WAVELENGTH
FOUR = ("HH", "HV", "VH", "VV")


def fresnel(cosine: float, permittivity: complex) -> tuple[complex, complex]:
    """TE and TM from the textbook's quotients."""
    root = np.sqrt(permittivity - 1.0 + cosine**2)
    return (cosine - root) / (cosine + root), (permittivity * cosine - root) / (permittivity * cosine + root)


def mirrored(e: C128, d: F64, n: F64, material: Material) -> tuple[C128, F64]:
    """Field and direction behind a smooth plane."""
    out, h = d - 2.0 * (d @ n) * n, np.cross(d, n) / np.linalg.norm(np.cross(d, n))
    te, tm = (-1.0, 1.0) if material.pec else fresnel(float(-d @ n), material.permittivity)
    return te * (e @ h) * h + tm * (e @ np.cross(h, d)) * np.cross(h, out), out


def on_the_wall(look: F64, normal: F64, wide: float, high: float, wall: Material, ground: Material) -> C128:
    """(2, 2) scattering matrix, rows H and V sent: currents of physical optics on a wall lit by endless ground.

    The wall's integral of ``exp(j k (s - d) . r)`` has no phase over the height.
    """
    h = np.cross(-look, [0.0, 0.0, 1.0])
    basis = [h / np.linalg.norm(h)]
    basis.append(np.cross(basis[0], -look))
    matrix = np.zeros((2, 2), dtype=complex)
    for i, sent in enumerate(basis):
        e, d = mirrored(sent.astype(complex), -look, np.array([0.0, 0.0, 1.0]), ground)
        e_out, d_out = mirrored(e, d, normal, wall)
        electric = np.cross(normal, np.cross(d, e) + np.cross(d_out, e_out))
        magnetic = np.cross(e + e_out, normal)
        for j, received in enumerate(basis):
            matrix[i, j] = 0.5 * received @ (electric + np.cross(magnetic, look))
    along = np.cross([0.0, 0.0, 1.0], normal)
    fill = np.sinc(2.0 * wide / WAVELENGTH * float(look @ along))
    return (matrix + matrix.T) * (2.0 * np.sqrt(np.pi) / WAVELENGTH * wide * high * fill)


@pytest.mark.parametrize("metal", [True, False])
def test_a_turned_wall_returns_what_its_own_currents_do(metal: bool) -> None:
    """Both orders of a wall on wide ground, 3 and 20 degrees off its normal, in all channels, level and sign."""
    wall = Material("wall", pec=metal, permittivity=5.24 - 0.507j)
    ground = Material("ground", pec=metal, permittivity=15.0 - 3.0j)
    wide, high = 0.3, 0.25
    for off in np.radians([3.0, 20.0]):
        normal, along = np.array([np.cos(off), np.sin(off), 0.0]), np.array([-np.sin(off), np.cos(off), 0.0])
        facade = targets.parallelogram(-0.5 * wide * along, wide * along, [0.0, 0.0, high])
        floor = targets.parallelogram([-0.1, -0.7, 0.0], [1.6, 0.0, 0.0], [0.0, 1.4, 0.0])
        look = targets.from_azimuth(np.zeros(2), np.radians([30.0, 55.0]))
        got = monostatic_rcs(
            targets.geometry([facade, floor], [0, 1]),
            (wall, ground),
            look,
            FREQUENCY,
            channels=FOUR,
            max_depth=2,
            keep_orders=True,
        ).amplitude[:, 1]
        want = np.array([on_the_wall(s, normal, wide, high, wall, ground).ravel() for s in look])
        # tol: tubes end at corners of the facets to -68 dB of what the wall returns at its peak
        floor = 4e-4 * 2.0 * np.sqrt(np.pi) / WAVELENGTH * wide * high
        np.testing.assert_allclose(np.abs(got), np.abs(want), atol=floor)
        turn = np.exp(1j * np.angle(got[:, 0] / want[:, 0]))
        np.testing.assert_allclose(got, want * turn[:, None], atol=2.0 * floor)
        np.testing.assert_array_equal(got[:, 1], got[:, 2])


def test_between_its_glints_a_box_on_ground_returns_what_the_exact_solution_does() -> None:
    """Cross-polar main lobe of the double bounce off its plane, and all azimuths, edges included.

    Was: 8 times the exact cross-polar amplitude; an error of 0.11 of the field.
    """
    lobe = full_wave.SCENES["box"].cuts[1]
    pick = slice(1, 9)
    exact = full_wave.read_stored()["box"][lobe.name][pick]
    got = full_wave.simulate_amplitudes("box", lobe, pick, edges=True)
    # tol: edges of 4 wavelengths, and waves between them: 1.5 % of the lobe; two mirrors would return 6.1
    assert np.abs(got[:, 1] - exact[:, 1]).max() < 1.3
    assert np.abs(got[:, 0] - exact[:, 0]).max() < 0.1 * np.abs(exact[:, 0]).max()
    low = full_wave.SCENES["box"].cuts[0]
    every = slice(0, None, 3)
    exact = full_wave.read_stored()["box"][low.name][every]
    got = full_wave.simulate_amplitudes("box", low, every, edges=True)
    for i in (0, 2):
        # tol: second diffraction, a twentieth of the field
        assert np.linalg.norm(got[:, i] - exact[:, i]) < 0.075 * np.linalg.norm(exact[:, i])


@pytest.mark.parametrize("angle_deg", [88.0, 97.0])
def test_a_bent_plate_rolled_about_the_look_turns_its_matrix(angle_deg: float) -> None:
    r"""Any roll t of a corner that is not square has ``S(t) = R(t) S(0) R(-t)``, and HV is VH to the bit."""
    half = 0.5 * np.radians(angle_deg)
    matrices = []
    for roll in np.radians([0.0, 35.0]):
        c, s = np.cos(roll), np.sin(roll)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        # seen 8 degrees off the bisector, along -x
        faces = [
            targets.parallelogram(
                [0.0, -0.15, 0.0], [0.3 * np.cos(a + 0.14), 0.0, 0.3 * np.sin(a + 0.14)], [0.0, 0.3, 0.0]
            )
            for a in (half, -half)
        ]
        shape = targets.geometry([(v @ turn.T, f) for v, f in faces])
        a = monostatic_rcs(shape, targets.PEC, [[1.0, 0.0, 0.0]], FREQUENCY, channels=FOUR).amplitude[0, 0]
        assert a[1] == a[2]
        # about the corner: bounds of another shape have another middle
        shift = np.exp(4j * np.pi / WAVELENGTH * shape.bounds[:, 0].mean())
        matrices.append(a.reshape(2, 2) * shift)
    level, rolled = matrices
    r = np.array([[c, -s], [s, c]])
    either = min(np.abs(rolled - x @ level @ x.T).max() for x in (r, r.T))  # the sense of h x v
    # tol: another lattice of rays against edges that end tubes at another angle
    assert either < 0.01 * np.abs(level).max()


@pytest.mark.parametrize(
    ("angle_deg", "arms", "bound_along", "bound_across"),
    [(88.0, (10, 10), 1.4, 0.9), (95.0, (10, 10), 4.2, 2.8)],
)
def test_a_bent_plate_against_the_method_of_moments(
    angle_deg: float, arms: tuple[float, float], bound_along: float, bound_across: float
) -> None:
    """Levels within 20 dB of a face's peak over +-60 degrees, rms; more in `benchmarks/studies/corner_angles.py`."""
    azimuth = np.radians(np.arange(-59.3, 60.1, 2.0))
    half = 0.5 * np.radians(angle_deg)
    ends = [
        a * WAVELENGTH * np.array([np.cos(t), np.sin(t)]) for a, t in zip(arms, (-half, half), strict=True)
    ]
    exact = theory.strips_by_moments([[ends[0], [0.0, 0.0], ends[1]]], WAVELENGTH, azimuth, step=1 / 15)
    length = 2.0 * WAVELENGTH
    faces = [targets.parallelogram([0, 0, 0], [*e, 0.0], [0, 0, length]) for e in ends]
    got = monostatic_rcs(targets.geometry(faces), targets.PEC, targets.from_azimuth(azimuth), FREQUENCY)
    floor = db_from_power(2.0 * np.pi / WAVELENGTH * (max(arms) * WAVELENGTH) ** 2) - 20.0
    for width, channel, bound in zip(exact, ("VV", "HH"), (bound_along, bound_across), strict=True):
        want = db_from_power(np.abs(width) ** 2)
        off = got.rcs_dbsm(channel) - want - db_from_power(2.0 * length**2 / WAVELENGTH)
        # tol: waves off the plates' ends that the other plate mirrors, which are not simulated
        assert np.sqrt(np.mean(off[want > floor] ** 2)) < bound


@pytest.mark.slow
def test_waves_between_the_faces_of_a_wide_corner_are_those_of_its_exact_solution() -> None:
    """Square corners of infinite length, by the method of moments, with the fringe currents of the outer edges.

    Edges' waves over the other face as over an endless mirror were tried: they add 0.6 of a root of a wavelength at all
    angles, which the exact solution has not, since the closings on both faces hold what the mirror returns.
    """
    wavelength, length = 1.0, 50.0
    angle = np.radians([42.0, 45.0, 48.0, 50.0])
    looks = np.stack([np.cos(angle), np.sin(angle), np.zeros(angle.size)], axis=1)
    for first, second in ((8.0, 30.0), (10.0, 20.0)):
        up = [0.0, 0.0, length]
        shape = targets.geometry(
            [
                targets.parallelogram([0, 0, -0.5 * length], edge, up)
                for edge in ([first, 0, 0], [0, second, 0])
            ]
        )
        along, across = theory.strips_by_moments(
            [[(first, 0.0), (0.0, 0.0), (0.0, second)]], wavelength, angle
        )
        edges = PointSource(FringeCurrents(edges_of(shape, targets.PEC, wavelength)), 3)
        for sources, allowed in (((), 0.025), ((edges,), 0.025)):
            found = monostatic_rcs(
                shape,
                targets.PEC,
                looks,
                SPEED_OF_LIGHT / wavelength,
                channels=("HH", "VV"),
                sources=sources,
            )
            low, high = shape.bounds
            turn = np.exp(4j * np.pi / wavelength * (looks @ (0.5 * (low + high))))
            got = found.amplitude.sum(axis=1) * turn[:, None] / (length * np.sqrt(2.0 / wavelength))
            for channel, exact in enumerate((across, along)):
                error = np.linalg.norm(got[:, channel] - exact) / np.linalg.norm(exact)
                print(f"{first:g} x {second:g}, {'HV'[channel]}, {len(sources)} sources: {error:.4f}")
                # tol: second diffraction between the outer edges, and from them to the other face
                assert error < allowed
