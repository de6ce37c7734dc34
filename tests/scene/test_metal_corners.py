"""Planned ray spacings of metal corners against closed forms, and rays that run along an axis but for rounding."""

import numpy as np
import pytest

from sarmitsuba.machine.backend import ensure_backend, mi
from sarmitsuba.scene.mesh.metal_corners import (
    ACROSS_CHAIN,
    FINEST_TUBE,
    MOST_RAYS,
    WIDEST_TUBE,
    corner_needs,
)
from sarmitsuba.tracing.kernel.intersector import intersector, query_ray
from tests.support.corners import plates

WAVELENGTH = 0.03


def needs(
    corners: np.ndarray, antennas: np.ndarray | None = None, closed: bool = False
) -> tuple[np.ndarray, ...]:
    """Planned and needed spacings of facets of two triangles each, wavelengths."""
    n = len(corners)
    metal, inside = np.ones(n, dtype=bool), np.full(n, closed)
    found = corner_needs(corners, np.arange(n) // 2, metal, inside, WAVELENGTH, antennas)
    return tuple(each / WAVELENGTH for each in found)


@pytest.mark.parametrize("wide", [0.6, 1.0, 2.0, 4.0, 7.0, 40.0])
@pytest.mark.parametrize("trihedral", [False, True])
def test_four_rays_across_a_chain(wide: float, trihedral: bool) -> None:
    """A quarter of the width, between a quarter of a wavelength and one and a half."""
    rng = np.random.default_rng(int(10 * wide))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    length = wide * WAVELENGTH if trihedral else 2.0
    corners = plates(wide * WAVELENGTH, length, trihedral=trihedral) @ turn.T + rng.normal(size=3)
    expected = np.clip(wide / ACROSS_CHAIN, FINEST_TUBE, WIDEST_TUBE)
    # tol: float64 rounding of coordinates
    assert needs(corners)[1] == pytest.approx(expected, rel=1e-6)


def test_facets_that_form_no_corner_need_nothing() -> None:
    """Parallel ones, narrow ones, and ones that are far apart."""
    corner = plates(4.0 * WAVELENGTH, 2.0, trihedral=False)
    apart = np.concatenate([corner[:2], corner[2:] + np.array([0.0, 50.0, 0.0])])
    level = np.concatenate([corner[:2], corner[:2] + np.array([0.0, 0.0, 0.5])])
    for corners in (apart, level, plates(0.3 * WAVELENGTH, 2.0, trihedral=False)):
        assert np.isinf(needs(corners)[1]).all()


def test_only_faces_that_an_antenna_sees() -> None:
    """Of closed bodies both facets must be seen from the front; sheets are seen from both sides."""
    corner = plates(4.0 * WAVELENGTH, 2.0, trihedral=False)
    corner[2:] = corner[2:, ::-1]
    front, back = np.array([[1e4, 1.0, 1e4]]), np.array([[-1e4, 1.0, -1e4]])
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (normals @ front[0] > 0.0).all()
    assert np.isfinite(needs(corner, front, closed=True)[1]).all()
    assert np.isinf(needs(corner, back, closed=True)[1]).all()
    assert np.isfinite(needs(corner, back)[1]).all()


def test_planned_rays_are_bounded_and_what_lacks_them_is_known() -> None:
    """Large corners are planned coarser than they need, or not, within the bound."""
    rng = np.random.default_rng(3)
    sizes = rng.uniform(0.5, 9.0, 12)
    corners = np.concatenate(
        [plates(s, s, trihedral=False) + np.array([0.0, 0.0, 100.0 * k]) for k, s in enumerate(sizes)]
    )
    planned, needed = needs(corners)
    assert np.isfinite(needed).all() and (planned >= needed).all() and (planned > needed).any()
    area = 0.5 * np.repeat(np.square(sizes), 4) / 2.0
    rays = (area / np.square(planned * WAVELENGTH)).sum()
    assert 0.0 < rays <= 0.5 * MOST_RAYS
    # small corners are served first
    assert (planned[: len(planned)][np.repeat(sizes, 4) == sizes.min()] == needed.min()).all()


def test_rays_along_an_axis_but_for_rounding_hit() -> None:
    """Without `query_ray` Embree misses a third of these: components of 0 and 1e-3 to 1e-30 in one packet."""
    ensure_backend()
    rng = np.random.default_rng(3)
    x = np.linspace(-50.0, 50.0, 11)
    low, high = np.meshgrid(x[:-1], x[:-1], indexing="ij"), np.meshgrid(x[1:], x[1:], indexing="ij")
    (a, b), (c, d) = low, high
    quads = np.stack([np.stack(p, axis=-1) for p in ((a, b), (c, b), (c, d), (a, d))], axis=-2).reshape(
        -1, 4, 2
    )
    quads = np.concatenate([quads, np.zeros((len(quads), 4, 1))], axis=2)
    scene = intersector(np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.float32))
    n = 64_000
    start, to = rng.uniform(-40.0, 40.0, (n, 3)), np.zeros((n, 3))
    start[:, 2], to[:, 2] = 30.0, -1.0
    to[:, :2] = 10.0 ** rng.uniform(-30.0, -3.0, (n, 2)) * rng.choice([0.0, 1.0, -1.0], (n, 2))
    origin, direction = (
        [mi.Float(column.astype(np.float32)) for column in rows.T.copy()] for rows in (start, to)
    )
    ray = query_ray(mi.Point3f(*origin), mi.Vector3f(*direction))
    found = scene.ray_intersect_preliminary(ray, coherent=True, active=True)
    assert np.asarray(found.is_valid(), dtype=bool).all()
    far = query_ray(mi.Point3f(*origin), mi.Vector3f(*direction), mi.Float(100.0))
    assert np.asarray(scene.ray_test(far, coherent=True, active=True), dtype=bool).all()
