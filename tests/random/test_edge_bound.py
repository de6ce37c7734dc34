"""Bound of an edge's return in a resolution cell against the sum over its pieces at all pulses."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.effects.bounds import Aperture, edge_bounds
from sarmitsuba.machine.backend import device_array, dr, ensure_backend, mi
from sarmitsuba.scene.mesh.sharp_edges import DIRECTIONS, SharpEdges
from sarmitsuba.tracing.scatterers.edges.diffraction import FringeCurrents

WAVELENGTH = 0.03
PULSES, EXAMINED = 129, 9


def drawn(rng: np.random.Generator) -> tuple[SharpEdges, Aperture, F64]:
    """One edge at any heading, half of them nearly across the line of sight; all pulses of the track."""
    reach, height = rng.uniform(300.0, 5000.0), rng.uniform(0.4, 1.2)
    heading = rng.uniform(0.0, 2.0 * np.pi)
    forward = np.array([np.cos(heading), np.sin(heading), 0.0])
    right = np.array([forward[1], -forward[0], 0.0])
    opening = rng.uniform(0.5, 20.0) * np.pi / 180.0
    middle = reach * (np.sin(height) * np.array([0.0, 0.0, 1.0]) - np.cos(height) * right)
    track = middle + np.linspace(-0.5, 0.5, PULSES)[:, None] * opening * reach * forward
    along = rng.normal(size=3)
    if rng.random() < 0.5:  # across the line of sight somewhere in the aperture, or beside it
        look = track[rng.integers(PULSES)] / np.linalg.norm(track[0])
        along -= look * (along @ look) / (look @ look)
        along += rng.choice([0.0, 0.01, 0.05]) * rng.normal(size=3)
    along /= np.linalg.norm(along)
    inward = np.cross(along, rng.normal(size=3))
    inward /= np.linalg.norm(inward)
    normal = np.cross(along, inward)
    angle = 2.0 if rng.random() < 0.3 else rng.uniform(1.1, 1.9)
    turn = (2.0 - angle) * np.pi  # of the other face, through the metal
    other = np.cos(turn) * inward - np.sin(turn) * normal
    away = -np.cos(turn) * normal - np.sin(turn) * inward
    edges = SharpEdges(
        np.zeros((1, 3)),
        np.array([10.0 ** rng.uniform(-1.0, 1.5)]),
        np.array([angle]),
        np.stack([inward, other])[None],
        np.stack([normal, away])[None],
        np.ones(1),
        np.full((1, DIRECTIONS), np.inf),
        -np.ones(1),
        np.zeros(1),
        np.ones((1, 2)),
    )
    pick = np.linspace(0, PULSES - 1, EXAMINED).round().astype(int)
    cells = rng.uniform(0.15, 1.0, 2)
    seen = track[pick]
    flown = np.broadcast_to(forward, seen.shape)
    return edges, Aperture(seen, seen, flown, 2.0 * np.pi / WAVELENGTH, cells[0], cells[1]), track


def echoes(pieces: SharpEdges, aperture: Aperture, place: F64) -> list[C128]:
    """Amplitudes of pieces HH, HV and VV without the phases of their ranges."""
    ray = place - pieces.middle
    look = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    constants = SimpleNamespace(constants=SimpleNamespace(wavenumber=mi.Float(aperture.wavenumber)))
    currents, number = FringeCurrents(pieces), dr.arange(mi.UInt32, pieces.n)
    leg = SimpleNamespace(to_antenna=vector(look))
    h = np.cross(look, [0.0, 0.0, 1.0])
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    both = [(vector(x), vector(0.0 * x)) for x in (h, np.cross(h, look))]
    pairs = ((0, 0), (0, 1), (1, 1))
    found = [currents.amplitude(constants, number, leg, leg, both[i], both[j]) for i, j in pairs]
    return [np.asarray(got.real) + 1j * np.asarray(got.imag) for got in found]


def strongest(edges: SharpEdges, aperture: Aperture, track: F64) -> float:
    """Largest RCS of a cell at any pulse, HH, HV or VV: pieces of two wavelengths, exact ranges."""
    pieces = edges.cut(2.0 * WAVELENGTH)
    forward, best = aperture.azimuth[0], 0.0
    for place in track[:: PULSES // 16]:
        ray = place - pieces.middle
        distance = np.linalg.norm(ray, axis=1)
        look = ray / distance[:, None]
        phase = np.exp(-2j * aperture.wavenumber * distance)
        side = forward - look[pieces.n // 2] * (look[pieces.n // 2] @ forward)
        across = pieces.middle @ side
        for amplitude in echoes(pieces, aperture, place):
            sums = np.concatenate([[0.0], np.cumsum(amplitude * phase)])
            for start in range(0, pieces.n, max(1, pieces.n // 40)):
                within = np.abs(distance[start:] - distance[start]) <= aperture.range_cell
                within &= np.abs(across[start:] - across[start]) <= aperture.azimuth_cell
                stop = start + (int(np.argmin(within)) if not within.all() else within.size)
                best = max(best, float(np.abs(sums[start + 1 : stop + 1] - sums[start]).max() ** 2))
    return best


def mean_echo(edges: SharpEdges, aperture: Aperture, track: F64) -> float:
    """Mean over the track of the RCS of the whole edge, of the strongest of HH, HV and VV."""
    # so short that their own amplitudes hardly change between the places where these are computed
    pieces, step = edges.cut(WAVELENGTH / 3.0), PULSES // 16
    along = (track[-1] - track[0]) / (PULSES - 1)
    power = np.zeros(3)
    for place in track[step // 2 :: step]:
        near = place + np.linspace(-0.5, 0.5, 96, endpoint=False)[:, None] * step * along
        distance = np.linalg.norm(near[:, None] - pieces.middle, axis=2)
        phase = np.exp(-2j * aperture.wavenumber * distance)
        power += [np.square(np.abs(phase @ a)).mean() / 16 for a in echoes(pieces, aperture, place)]
    return float(power.max())


def vector(rows: F64) -> mi.Vector3f:
    return mi.Vector3f(*(device_array(mi.Float, column) for column in rows.T.astype(np.float32)))


@pytest.mark.parametrize(
    ("seed", "count"), [(1, 6), *(pytest.param(seed, 40, marks=pytest.mark.slow) for seed in range(2, 7))]
)
def test_bound_of_drawn_edges(seed: int, count: int) -> None:
    ensure_backend()
    rng = np.random.default_rng(seed)
    over, energy_over = [], []
    for _ in range(count):
        edges, aperture, track = drawn(rng)
        bounds = edge_bounds(edges, aperture)
        got, bound = strongest(edges, aperture, track), float(bounds.cell[0])
        if bound == 0.0:
            assert got == 0.0
            continue
        over.append(10.0 * np.log10(bound / max(got, 1e-30)))
        if seed > 1 or not energy_over:  # one in the fast tests
            mean = mean_echo(edges, aperture, track)
            energy_over.append(10.0 * np.log10(float(bounds.energy[0]) / max(mean, 1e-30)))
    print(f"bound over return, dB: {np.round(np.sort(over), 1)}, energy: {np.round(np.sort(energy_over), 1)}")
    assert min(over) > 0.0 and min(energy_over) > 0.0
    assert np.median(over) < 10.0 and np.median(energy_over) < 12.0


@pytest.mark.parametrize("slot", [0, 7, 150])
def test_no_edge_is_passed_over(slot: int) -> None:
    """One long edge that shines, anywhere among short ones, of which few are examined; one leg mirrored too."""
    rng = np.random.default_rng(9)
    several = [drawn(rng) for _ in range(160)]
    columns = (
        np.concatenate([getattr(edges, f.name) for edges, _, _ in several])
        for f in fields(SharpEdges)
        if f.name != "doubled"
    )
    edges, aperture = SharpEdges(*columns), several[0][1]
    edges.length[:] = 20.0
    order = np.arange(edges.n)
    brightest = int(edge_bounds(edges, aperture).cell.argmax())
    order[[slot, brightest]] = brightest, slot
    edges = edges.of(order)
    edges.length[:] = rng.uniform(0.05, 0.2, edges.n)
    edges.length[slot] = 20.0
    for mirrors in ((False, False), (True, False)):
        whole, few = (edge_bounds(edges, aperture, mirrors, examined=count) for count in (None, 20))
        # tol: rounding, of the same sums in another order
        assert (few.cell >= 0.999999 * whole.cell).all() and (few.energy >= 0.999999 * whole.energy).all()
        assert np.isclose(few.cell, whole.cell, rtol=1e-6).sum() >= 20
        if mirrors == (False, False):
            assert few.cell[slot] == pytest.approx(float(whole.cell.max()), rel=1e-6)
