"""The part of a facet that a ray stands for, and the short way for rays far from its edges."""

import numpy as np

from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.tracing.kernel.tubes import polygon
from sarmitsuba.tracing.kernel.tubes.tube import limit_extent, make_unlimited, patch

SPACING = 0.25  # m


def bounds_of(middle: np.ndarray, half: np.ndarray, turn: np.ndarray) -> polygon.Bounds:
    """Rays at the origin on rectangles of given middle, half extents (2, n) m and angle, on the ground."""
    u, v = mi.Vector3f(SPACING, 0.0, 0.0), mi.Vector3f(0.0, SPACING, 0.0)
    point = mi.Vector3f(0.0)
    edges = []
    for k in range(4):
        angle = turn + 0.5 * np.pi * k
        inward = -np.stack([np.cos(angle), np.sin(angle)])
        offset = (inward * middle).sum(axis=0) - half[k % 2]
        edges.append(mi.Vector4f(*(mi.Float(x.astype(np.float32)) for x in (*inward, 0.0 * turn, offset))))
    extent = limit_extent(make_unlimited(), edges, point, u, v)
    lines = polygon.facet_lines(edges, [mi.Bool(False)] * 4, point, u, v)
    return polygon.Bounds(lines, extent, patch(extent).rim, mi.Bool(True))


def test_rays_far_from_edges_have_their_cell() -> None:
    """Where all edges are said to be far the part is the ray's cell, elsewhere the part as it is worked out."""
    ensure_backend()
    rng = np.random.default_rng(5)
    n = 20000
    half = rng.uniform(0.5, 8.0, (2, n)) * SPACING
    turn = rng.uniform(0.0, 2.0 * np.pi, n)
    middle = 0.9 * rng.uniform(-1.0, 1.0, (2, n)) * half
    middle = np.stack(
        [
            middle[0] * np.cos(turn) - middle[1] * np.sin(turn),
            middle[0] * np.sin(turn) + middle[1] * np.cos(turn),
        ]
    )
    bounds = bounds_of(middle, half, turn)
    q = mi.Vector3f(*(mi.Float(x) for x in rng.uniform(-15.0, 15.0, (2, n)).astype(np.float32)), 0.0)
    u, v = mi.Vector3f(SPACING, 0.0, 0.0), mi.Vector3f(0.0, SPACING, 0.0)
    longest = mi.Float(0.35)
    apart = bounds.apart().numpy()
    assert 0.1 < apart.mean() < 0.9

    short, *short_place = polygon.phase_integral(q, u, v, bounds, longest)
    long, *long_place = polygon.part_integral(q, u, v, bounds.part(), longest)
    for a, b in zip((short.real, short.imag, *short_place), (long.real, long.imag, *long_place), strict=True):
        # tol: float32 rounding of sums over sides whose terms are below ten
        np.testing.assert_allclose(a.numpy(), b.numpy(), atol=2e-6)

    area = bounds.area().numpy()
    np.testing.assert_allclose(area[apart], 1.0, atol=1e-6)  # tol: float32 rounding
    np.testing.assert_allclose(
        area, bounds.part().area().numpy(), atol=1e-4
    )  # tol: float32, parts up to 9 x 9 cells

    # no line within reach of a ray that is said to be far from all: corners of its three by three cells lie inside
    for x, y in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        px, py = x * SPACING - middle[0], y * SPACING - middle[1]
        along = np.abs(px * np.cos(turn) + py * np.sin(turn))
        across = np.abs(-px * np.sin(turn) + py * np.cos(turn))
        assert ((along < half[0]) & (across < half[1]))[apart].all()


def test_cell_has_the_closed_form() -> None:
    """Not cut off from its neighbours, a ray's cell returns sinc(q.u / 2) sinc(q.v / 2)."""
    ensure_backend()
    rng = np.random.default_rng(6)
    n = 1000
    far = np.full((2, n), 100.0)
    bounds = bounds_of(np.zeros((2, n)), far, np.full(n, 0.3))
    assert bounds.apart().numpy().all()
    # less than two from ray to ray: nothing is left out
    qu, qv = rng.uniform(-0.7, 0.7, (2, n))
    q = mi.Vector3f(*(mi.Float((x / SPACING).astype(np.float32)) for x in (qu, qv)), 0.0)
    u, v = mi.Vector3f(SPACING, 0.0, 0.0), mi.Vector3f(0.0, SPACING, 0.0)
    value, *place = polygon.phase_integral(q, u, v, bounds, mi.Float(SPACING))
    turned = qu * place[0].numpy() + qv * place[1].numpy()
    expected = np.sinc(0.5 * qu / np.pi) * np.sinc(0.5 * qv / np.pi) * np.exp(-1j * turned)
    got = value.real.numpy() + 1j * value.imag.numpy()
    # tol: float32 terms of 1 / |Q|^2 up to 1000 that cancel
    np.testing.assert_allclose(got, expected, atol=1e-3)
    assert dr.width(value) == n


def test_cancelled_tubes_return_nothing() -> None:
    """Where the sides of a tube are said to cancel its integral is zero; so it is inside a facet of any size."""
    ensure_backend()
    rng = np.random.default_rng(7)
    n = 20000
    # up to some two thousand tubes wide: edges too far away to be represented as lines
    half = SPACING * 10.0 ** rng.uniform(0.0, 3.3, (2, n))
    turn = rng.uniform(0.0, 2.0 * np.pi, n)
    middle = 0.5 * rng.uniform(-1.0, 1.0, (2, n)) * half.min(axis=0)
    bounds = bounds_of(middle, half, turn)
    q = mi.Vector3f(*(mi.Float(x) for x in rng.uniform(-15.0, 15.0, (2, n)).astype(np.float32)), 0.0)
    u, v = mi.Vector3f(SPACING, 0.0, 0.0), mi.Vector3f(0.0, SPACING, 0.0)
    value, *_ = polygon.part_integral(q, u, v, bounds.part(), mi.Float(0.35))
    size = np.hypot(value.real.numpy(), value.imag.numpy())
    for kept_up_to, phase in ((None, polygon.INNER_UP_TO), (mi.Float(0.5), 0.5)):
        cancelled = bounds.cancels(q, u, v, kept_up_to).numpy()
        fast = SPACING * np.hypot(*(x.numpy() for x in (q.x, q.y))) > phase + 1e-3  # tol: float32 rounding
        assert (cancelled == (fast & bounds.apart().numpy())).mean() > 0.999  # but for phases near the limit
        assert 0.2 < cancelled.mean() < 0.95
        if kept_up_to is None:
            assert (size[cancelled] == 0.0).all()
            assert (size[~cancelled] > 0.0).mean() > 0.5
