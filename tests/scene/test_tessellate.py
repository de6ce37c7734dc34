"""Analytic shapes as triangles: closed, outwards, within the chord error."""

import numpy as np
import pytest
import trimesh

from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.mesh.tessellate import cube, cylinder, disk, rectangle, sphere


def normals(v, f):
    n = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def surface_points(v, f, n=24):
    """Points all over every facet, corners and edges included."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
    i, j = i[i + j <= n] / n, j[i + j <= n] / n
    w = np.column_stack([i, j, 1 - i - j])
    return np.einsum("pk,fkc->fpc", w, v[f]).reshape(-1, 3)


@pytest.mark.parametrize(
    "mesh", [rectangle(), cube(), disk(0.01), sphere(1.0, 0.01), cylinder(1.0, 0.0, 1.0, 0.01)]
)
def test_types_and_index_range(mesh):
    v, f = mesh
    assert v.dtype == np.float64
    assert f.dtype == np.int32
    assert f.min() == 0
    assert f.max() == len(v) - 1


def test_rectangle_faces_up():
    v, f = rectangle()
    np.testing.assert_array_equal(normals(v, f), [[0, 0, 1], [0, 0, 1]])
    assert trimesh.Trimesh(v, f, process=False).area == 4.0


def test_cube_is_closed_and_outwards():
    t = trimesh.Trimesh(*cube(), process=False)
    assert t.is_watertight
    assert t.volume == pytest.approx(8.0, rel=1e-14)  # tol: float rounding


@pytest.mark.parametrize("radius", [0.3, 1.0, 40.0])
@pytest.mark.parametrize("relative", [0.1, 0.01, 0.001])
def test_sphere_within_sagitta_and_its_mean_on_the_surface(radius, relative):
    v, f = sphere(radius, relative * radius)
    t = trimesh.Trimesh(v, f, process=False)
    assert t.is_watertight
    assert t.volume > 0
    r = np.linalg.norm(surface_points(v, f), axis=1)
    assert np.abs(r - radius).max() <= relative * radius
    # area mean of the distance: the sampled points of nearly equal facets; tol: discretisation of that mean
    assert r.mean() == pytest.approx(radius, abs=0.15 * relative * radius)
    assert t.area == pytest.approx(4 * np.pi * radius**2, rel=2.0 * relative)


def test_sphere_is_not_finer_than_needed():
    # a facet of circumradius rho has the chord height rho^2 / 2R; 20 n^2 equal facets would need this many
    sagitta = 1e-3
    ideal = 4 * np.pi / (3 * np.sqrt(3) / 4 * 2 * sagitta)
    assert len(sphere(1.0, sagitta)[1]) < 2.0 * ideal


def test_spheres_of_one_size_do_not_share_arrays():
    vertices, faces = sphere(2.0, 1e-3)
    kept = vertices.copy(), faces.copy()
    vertices[:], faces[:] = 0.0, 0
    for got, want in zip(sphere(2.0, 1e-3), kept, strict=True):
        assert np.array_equal(got, want)


def test_sphere_keeps_to_the_longest_edge():
    v, f = sphere(2.0, 1.0, edge=0.2)
    longest = np.linalg.norm(v[f] - v[np.roll(f, 1, axis=1)], axis=2).max()
    assert 0.17 < longest <= 0.2
    assert trimesh.Trimesh(v, f, process=False).is_watertight


@pytest.mark.parametrize("edge", [0.55, np.inf])
def test_sphere_facets_of_half_a_wavelength_raise_no_grating_lobes(edge):
    # physical optics of the facets, summed exactly enough (6 x 6 points a facet), against that of the sphere;
    # ka = 60. With the edge bounded it is within 0.1 dB, by the sagitta alone (lambda / 32) up to 0.3 dB off
    lam, ka = 1.0, 60.0
    radius, k = ka * lam / (2 * np.pi), 2 * np.pi / lam
    v, f = sphere(radius, lam / 32, edge=edge * lam)
    a, m = v[f], 6
    i, j = np.meshgrid(np.arange(m), np.arange(m))
    low, high = i + j < m, i + j < m - 1
    w = (
        np.concatenate(
            [np.stack([i + 1 / 3, j + 1 / 3], -1)[low], np.stack([i + 2 / 3, j + 2 / 3], -1)[high]]
        )
        / m
    )
    points = np.einsum("pk,fkc->fpc", np.column_stack([1 - w.sum(axis=1), w]), a)
    cross = np.cross(a[:, 1] - a[:, 0], a[:, 2] - a[:, 0])
    exact = np.pi * radius**2 * (1 - np.sin(2 * ka) / ka + (np.sin(ka) / ka) ** 2)
    worst = 0.0
    for look in np.random.default_rng(5).normal(size=(6, 3)):
        d = look / np.linalg.norm(look)
        lit = np.clip(cross @ d, 0, None) / (2 * m * m)
        field = (lit[:, None] * np.exp(2j * k * (points @ d))).sum()
        worst = max(worst, abs(10 * np.log10(4 * np.pi / lam**2 * abs(field) ** 2 / exact)))
    if np.isfinite(edge):
        assert worst < 0.1  # tol: ripple left by the facets at the shadow boundary
    else:
        assert 0.1 < worst < 0.5


def test_disk_has_the_area_of_the_disk():
    v, f = disk(0.01, 2.5)
    assert trimesh.Trimesh(v, f, process=False).area == pytest.approx(
        np.pi * 2.5**2, rel=1e-12
    )  # tol: rounding
    assert (normals(v, f)[:, 2] > 0.999999).all()
    rim = np.linalg.norm(surface_points(v, np.column_stack([f[:, 1:], f[:, 1]])), axis=1)
    assert np.abs(rim - 2.5).max() <= 0.01


def test_cylinder_within_sagitta_and_outwards():
    v, f = cylinder(0.7, 2.0, -1.0, 0.002)
    p = surface_points(v, f)
    r = np.hypot(p[:, 0], p[:, 1])
    assert np.abs(r - 0.7).max() <= 0.002
    assert r.mean() == pytest.approx(0.7, abs=0.0002)  # tol: discretisation of the sampled mean
    center = v[f].mean(axis=1)
    assert (np.einsum("ij,ij->i", normals(v, f)[:, :2], center[:, :2]) > 0).all()
    assert (v[:, 2].min(), v[:, 2].max()) == (-1.0, 2.0)


@pytest.mark.parametrize(
    "call", [lambda: sphere(0.0, 0.1), lambda: disk(-1.0), lambda: cylinder(1, 0, 1, np.nan)]
)
def test_meaningless_bounds_are_refused(call):
    with pytest.raises(SceneError, match="must be positive and finite"):
        call()


def test_absurdly_fine_shapes_are_refused_before_memory_runs_out():
    with pytest.raises(SceneError, match="raise the sagitta"):
        sphere(1e3, 1e-5)
    with pytest.raises(SceneError, match="raise the sagitta"):
        disk(1e-15)
