"""Solved surface currents against exact series, an independent solver, and themselves in other meshes."""

import itertools
from collections.abc import Callable, Sequence
from types import ModuleType

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError, SceneError
from sarmitsuba.effects.omitted_waves import polarisation_vectors
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.machine.backend import ensure_backend
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.remesh import contacts
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.render import render
from sarmitsuba.simulation.execution.turntable import Aspects, RcsSweep, rcs_sweep
from sarmitsuba.tracing.scatterers.currents import solution
from sarmitsuba.tracing.scatterers.currents.basis import CurrentBasis
from sarmitsuba.tracing.scatterers.currents.matrix import MomentMatrices, NearPairs
from sarmitsuba.tracing.scatterers.currents.solution import BodyMesh, WholeSurface, scattering_matrices
from sarmitsuba.truth import theory

# small bodies are far outside ray optics
pytestmark = pytest.mark.filterwarnings("ignore:.*levels are not better than", "ignore:.*theory not known")


def looks_at(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) and their polarisation vectors (n, 2, 3)."""
    look = rng.normal(size=(n, 3))
    look /= np.linalg.norm(look, axis=1, keepdims=True)
    return look, np.stack(polarisation_vectors(look), axis=1)


def solved(corners: np.ndarray, length: float, look: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """Amplitudes [direction, received, sent] at a wavelength of 1 m."""
    ensure_backend()
    return scattering_matrices(WholeSurface.of(corners, length).make_mesh(length), 1.0, look, fields).matrices


def body(mesh: trimesh.Trimesh, material: object = "pec", **settings: object) -> Scene:
    """Scene with one body, at a wavelength of 1 m."""
    scene = build_scene(
        [SceneMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32), material, "body")],  # type: ignore[arg-type]
        radar=RadarDescription(center_frequency=SPEED_OF_LIGHT),
    )
    return scene.replace(**settings)


def sweep(scene: Scene, azimuth_deg: np.ndarray, elevation_deg: float = 10.0, **options: object) -> RcsSweep:
    azimuth = np.radians(azimuth_deg)
    aspects = Aspects(azimuth, np.full(azimuth.size, np.radians(elevation_deg)))
    return rcs_sweep(scene, aspects, channels=("HH", "VV"), **options)  # type: ignore[arg-type]


def test_spheres_against_the_mie_series_also_where_the_space_inside_resonates() -> None:
    look, fields = looks_at(np.random.default_rng(1), 6)
    sphere = trimesh.creation.icosphere(subdivisions=3)
    for ka in (1.3, 2.744):  # the second: the lowest resonance inside
        radius = ka / (2.0 * np.pi)
        s = solved(np.asarray(sphere.triangles) * radius, 1.0 / 16.0, look, fields)
        exact = np.pi * radius**2 * theory.sphere_mie(ka)
        level = 10.0 * np.log10(np.square(np.abs(s[:, [0, 1], [0, 1]])) / exact)
        # tol: chords of a sixteenth of a wavelength: the body is 2 % smaller, and the currents are of first order
        assert np.abs(level).max() < 0.35
        assert np.abs(s[:, 0, 1]).max() < 0.02 * np.abs(s[:, 0, 0]).max()


def test_a_sphere_of_meridians_against_the_mie_series() -> None:
    """Slivers at its poles were refused as parts that touch."""
    look, fields = looks_at(np.random.default_rng(2), 3)
    ball = trimesh.creation.uv_sphere(0.5 / np.pi, count=[20, 40])
    s = solved(np.asarray(ball.triangles), 1.0 / 12.0, look, fields)
    level = 10.0 * np.log10(np.square(np.abs(s[:, [0, 1], [0, 1]])) * np.pi * 4.0 / theory.sphere_mie(1.0))
    # tol: chords of a twelfth of a wavelength, as above
    assert np.abs(level).max() < 0.35


def test_a_thin_rod_at_resonance_against_a_wire_and_what_its_losses_change() -> None:
    length, look = 0.465, np.array([[1.0, 0.0, 0.0]])
    fields = np.stack(polarisation_vectors(look, np.array([0.0, 0.0, 1.0])), axis=1)
    rod = trimesh.creation.cylinder(length / 150.0, length, sections=8)
    whole = WholeSurface.of(np.asarray(rod.triangles), 1.0 / 7.0)
    mesh = whole.make_mesh(1.0 / 16.0)
    assert not len(contacts(mesh.vertices, mesh.faces, 0.1 * mesh.length))
    ensure_backend()
    found = scattering_matrices(mesh, 1.0, look, fields)
    wire = np.abs(theory.thin_wire_moments(length, length / 150.0, 1.0, 0.0, 80)[0]) ** 2
    # tol: eight sides for a circle, and ends that the wire does not have
    assert 10.0 * np.log10(np.abs(found.matrices[0, 1, 1]) ** 2 / wire) == pytest.approx(0.0, abs=0.2)
    assert 0.0 < np.abs(found.losses[0, 1, 1]) < 3e-3 * np.abs(found.matrices[0, 1, 1])
    assert np.abs(found.residual).max() < 1e-3 * np.abs(found.matrices).max()


def test_what_losses_change_is_the_difference_of_two_solutions(monkeypatch: pytest.MonkeyPatch) -> None:
    look, fields = looks_at(np.random.default_rng(3), 2)
    mesh = WholeSurface.of(np.asarray(trimesh.creation.box((0.6, 0.5, 0.4)).triangles), 0.15).make_mesh(0.15)
    ensure_backend()
    lossy = scattering_matrices(mesh, 1.0, look, fields)
    monkeypatch.setattr(solution, "RESISTANCE", 0.0)
    lossless = scattering_matrices(mesh, 1.0, look, fields)
    change = lossy.matrices - lossless.matrices
    # tol: second order in the losses, and float32 in the equations
    assert np.abs(change - lossy.losses).max() < 0.05 * np.abs(change).max()


def test_drawn_bodies_against_an_independent_solver(benchmark_script: Callable[[str], ModuleType]) -> None:
    """Convex bodies and open sheets, turned and off the origin, in all channels with their phases."""
    other = benchmark_script("dense_moments")
    rng = np.random.default_rng(11)
    for i in range(2):
        if i:  # a bent sheet
            a, b, c = rng.uniform(0.4, 0.7, 3)
            patches = [
                other.rectangle([0, 0, 0], [a, 0, 0], [0, b, 0], 0.08),
                other.rectangle([0, 0, 0], [0, b, 0], [0, 0, c], 0.08),
            ]
            vertices, faces = other.welded(patches)
        else:
            hull = trimesh.convex.convex_hull(rng.normal(size=(7, 3)) * 0.15)
            while np.asarray(hull.edges_unique_length).max() > 0.12:
                hull = hull.subdivide()
            vertices, faces = np.asarray(hull.vertices), np.asarray(hull.faces)
        vertices = vertices @ Rotation.random(random_state=i).as_matrix().T + rng.uniform(-1.0, 1.0, 3)
        look, fields = looks_at(rng, 8)
        expected = other.amplitudes((vertices, faces), look)
        found = solved(vertices[faces], 1.0 / 12.0, look, fields)
        got = np.stack([found[:, 0, 0], found[:, 1, 1]], axis=1)
        scale = np.abs(expected).max()
        # tol: both meshes have edges of a twelfth of a wavelength, with errors of their own at sharp edges
        assert np.abs(np.abs(got) - np.abs(expected)[:, : got.shape[1]]).max() < 0.06 * scale
        assert np.abs(found[:, 0, 1] - found[:, 1, 0]).max() < 1e-3 * scale  # reciprocity


def test_far_pairs_are_the_sum_over_three_points_in_float64() -> None:
    """Every element of the matrix that the device adds up, with a mirror plane."""
    ensure_backend()
    rng = np.random.default_rng(9)
    sheet = rng.uniform(0.1, 1.5, (5, 3))
    faces = np.array([[0, 1, 2], [1, 2, 3], [0, 2, 4], [1, 2, 4]])  # three triangles share an edge
    basis = CurrentBasis.of(sheet, faces, np.array([[1.0, 0.0, 0.0]]), 1e-6)
    near = NearPairs(tuple((np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3, 3))) for _ in range(2)))
    even, odd = basis.symmetries()
    for part in (even, odd):
        expected = np.zeros((part.kept.size, part.kept.size), dtype=np.complex128)
        for copy, sign in zip(basis.copies, part.signs, strict=True):
            for t, source in itertools.product(range(len(basis.corners)), repeat=2):
                a, b = basis.corners[t], basis.corners[source] @ copy.T
                x, y = (0.5 * (c + c.mean(axis=0)) for c in (a, b))
                for i, j in itertools.product(range(3), repeat=2):
                    m, n = part.function[t, i], part.function[source, j]
                    if m < 0 or n < 0:
                        continue
                    weight = sign * basis.weight[t, i] * basis.weight[source, j] / 9.0
                    for p, q in itertools.product(x, y):
                        r = np.linalg.norm(p - q)
                        if r > 1e-9:
                            flow = (p - a[i]) @ (q - b[j]) - 4.0
                            expected[m, n] += weight * flow * np.exp(-1j * r) / (4.0 * np.pi * r)
        found = MomentMatrices(basis, near, ()).matrix(part)
        # tol: float32
        assert np.abs(found - expected).max() < 2e-6 * np.abs(expected).max()


def test_the_same_body_gives_the_same_bits() -> None:
    """Whatever order threads add in."""
    look, fields = looks_at(np.random.default_rng(8), 3)
    ball = np.asarray(trimesh.creation.icosphere(subdivisions=3).triangles) * 0.4
    first = solved(ball, 0.07, look, fields)
    assert all(np.array_equal(first, solved(ball, 0.07, look, fields)) for _ in range(2))


def test_mirrored_parts_are_the_whole_body() -> None:
    """A box and an open sheet solved as an eighth, a quarter and whole; a body without mirrors has none."""
    rng = np.random.default_rng(3)
    look, fields = looks_at(rng, 6)
    box = np.asarray(trimesh.creation.box((0.9, 0.6, 0.7)).triangles)
    sheet = np.array(
        [[[0.0, -0.5, -0.4], [0, 0.5, -0.4], [0, 0.5, 0.4]], [[0, -0.5, -0.4], [0, 0.5, 0.4], [0, -0.5, 0.4]]]
    )
    for corners, planes in ((box, 3), (sheet, 2)):
        part = WholeSurface.of(corners, 0.1).make_mesh(0.1)
        assert len(part.normals) == planes
        pieces = [part.vertices[part.faces]]
        for normal in part.normals:
            pieces += [p - 2.0 * (p @ normal)[..., None] * normal for p in pieces]
        whole = WholeSurface.of(np.concatenate(pieces) + np.array([1e-7, 0.0, 0.0]), 0.1).make_mesh(0.1)
        ensure_backend()
        one = scattering_matrices(part, 1.0, look, fields).matrices
        joined, number = np.unique(
            np.round(np.concatenate(pieces).reshape(-1, 3), 9), axis=0, return_inverse=True
        )
        plain = BodyMesh(joined, number.reshape(-1, 3), np.zeros(3), np.zeros((0, 3)), 0.1)
        for mesh in (part, plain, whole):
            assert (mesh.closed == (planes == 3)).all()
        two = scattering_matrices(plain, 1.0, look, fields).matrices
        # tol: float32 in the far pairs and in the factorisation
        assert np.abs(one - two).max() < 1e-4 * np.abs(two).max()
    bumped = np.concatenate([box, box[:1] * 0.2 + [0.3, 0.1, 0.5]])
    assert len(WholeSurface.of(bumped, 0.1).make_mesh(0.1).normals) < 3


def test_t_junctions_slivers_and_gaps_change_nothing() -> None:
    """A box whose faces are cut apart at random, without common corners, with gaps of a ten-thousandth."""
    rng = np.random.default_rng(5)
    look, fields = looks_at(rng, 5)
    box = trimesh.creation.box((0.9, 0.6, 0.7))
    torn = []
    for triangle in np.asarray(box.triangles):
        pieces = [triangle]
        for _ in range(3):
            t = pieces.pop(int(rng.integers(len(pieces))))
            i, share = int(rng.integers(3)), rng.uniform(0.02, 0.98)
            a, b, c = t[i], t[(i + 1) % 3], t[(i + 2) % 3]
            m = a + share * (b - a)
            pieces += [np.array([a, m, c]), np.array([m, b, c])]
        torn += pieces
    corners = np.array(torn) + rng.uniform(-1e-4, 1e-4, (len(torn), 3, 3))
    mesh = WholeSurface.of(corners, 0.09).make_mesh(0.09)
    assert mesh.closed.all()
    clean, cut = solved(np.asarray(box.triangles), 0.09, look, fields), solved(corners, 0.09, look, fields)
    # tol: two meshes of edges of an eleventh of a wavelength
    assert np.abs(clean - cut).max() < 0.05 * np.abs(clean).max()


def test_error_by_the_mesh_is_stated_and_falls_with_it() -> None:
    rng = np.random.default_rng(7)
    corners = np.array([[[0.0, 0, 0], [0, 1.1, 0], [0, 1.1, 0.8]], [[0, 0, 0], [0, 1.1, 0.8], [0, 0, 0.8]]])
    look, fields = looks_at(rng, 30)
    exact = solved(corners, 1.0 / 26.0, look, fields)
    errors = []
    for n in (6.0, 10.0, 16.0):
        found = solved(corners, 1.0 / n, look, fields)
        errors.append(float(np.sqrt(np.mean(np.abs(found - exact) ** 2) / np.mean(np.abs(exact) ** 2))))
    assert errors[0] > 1.3 * errors[1] > 1.3**2 * errors[2]
    assert errors[2] < 0.03


def test_a_small_body_is_solved_by_itself_and_the_statement_holds() -> None:
    """The sweep of a bent sheet at default settings against a finer mesh; ray optics alone is worse by far."""
    sheet = trimesh.Trimesh(
        [[0, 0, 0], [1.3, 0, 0], [1.3, 1.1, 0], [0, 1.1, 0], [0, 0, 0.9], [0, 1.1, 0.9]],
        [[0, 1, 2], [0, 2, 3], [0, 3, 5], [0, 5, 4]],
        process=False,
    )
    azimuth = np.arange(0.0, 360.0, 30.0)
    found = sweep(body(sheet), azimuth)
    rays = sweep(body(sheet, full_wave="off"), azimuth)
    assert found.currents is not None and rays.currents is None
    assert np.allclose(
        found.result.amplitude.sum(axis=1), rays.result.amplitude.sum(axis=1), rtol=0.2, atol=0.1
    )
    look = found.aspects.directions
    exact = solved(
        np.asarray(sheet.triangles), 1.0 / 24.0, look, np.stack(polarisation_vectors(look), axis=1)
    )
    # about the middle of its bounds
    middle = np.asarray(sheet.bounds).mean(axis=0)
    exact = exact * np.exp(-4j * np.pi * (look @ middle))[:, None, None]
    reference = exact[:, [0, 1], [0, 1]]
    assert np.abs(found.total - reference).max() < 0.1 * np.abs(reference).max()
    for i, channel in enumerate(("HH", "VV")):
        level = 20.0 * np.log10(np.abs(reference[:, i]))
        strong = level > level.max() - 20.0
        true = [np.sqrt(np.mean((s.dbsm(channel) - level)[strong] ** 2)) for s in (found, rays)]
        assert true[0] < 0.4 and true[0] < found.statement.total_db[i] < 1.5
        assert true[1] > 3.0 * true[0]
    assert "method of moments" in found.statement.text and "ray optics alone" in found.statement.text


def test_bodies_that_ray_optics_has_are_left_to_it() -> None:
    box = trimesh.creation.box((12.0, 9.0, 15.0))
    assert sweep(body(box, edge_diffraction="on"), np.array([0.0, 10.0])).currents is None
    small = trimesh.creation.box((0.8, 0.6, 0.5))
    assert sweep(body(small), np.array([0.0, 10.0]), checked=0).currents is None
    assert (
        sweep(body(small, Material("glass", permittivity=4.0 - 0.01j)), np.array([0.0, 10.0])).currents
        is None
    )


@pytest.mark.parametrize(
    ("material", "text"),
    [
        (Material("glass", permittivity=4.0 - 0.01j), "glass is not a perfect conductor"),
        (Material("rough metal", pec=True, rms_height=0.1), "surfaces are rough"),
    ],
)
def test_what_cannot_be_solved_is_refused_in_one_line(material: Material, text: str) -> None:
    box = trimesh.creation.box((0.8, 0.6, 0.5))
    with pytest.raises(RadarError, match=text) as caught:
        sweep(body(box, material, full_wave="on"), np.array([0.0]))
    assert "\n" not in str(caught.value)


def test_a_body_given_twice_is_solved_as_one() -> None:
    """Faces of a second shape hid its edges from the statement of ray optics, which seemed exact."""
    box = trimesh.creation.box((0.5, 0.4, 0.3))
    mesh = np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int32)
    radar = RadarDescription(center_frequency=SPEED_OF_LIGHT)
    twice = build_scene([SceneMesh(*mesh, "pec", "a"), SceneMesh(*mesh, "pec", "b")], radar=radar)
    azimuth = np.array([0.0, 40.0])
    one, two = sweep(body(box), azimuth), sweep(twice, azimuth)
    assert two.currents is not None and np.allclose(one.total, two.total)


def test_bodies_far_below_a_wavelength_are_solved_or_said_to_be_unknown() -> None:
    """Cubes of a tenth of a wavelength against their static polarisabilities; smaller ones are not known."""
    for edge in (0.06, 0.1):
        found = sweep(body(trimesh.creation.box((edge, edge, edge))), np.array([0.0]), 0.0)
        # Sihvola and others: polarisabilities of a metal cube over its volume, 3.644 electric and 1.607 magnetic
        exact = (2.0 * np.pi) ** 4 / (4.0 * np.pi) * (5.251 * edge**3) ** 2
        assert found.currents is not None
        # tol: the next order in the edge, (2 pi edge)^2 / 5 of the amplitude, and edges of the mesh
        assert found.dbsm("HH")[0] == pytest.approx(10.0 * np.log10(exact), abs=1.0)
    tiny = sweep(body(trimesh.creation.box((0.004, 0.004, 0.004))), np.array([0.0]), 0.0)
    assert tiny.currents is None and tiny.statement.theory.unknown


def test_crossing_sheets_are_refused_with_their_place() -> None:
    sheet = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    cross = trimesh.Trimesh(
        np.concatenate([sheet, sheet[:, [0, 2, 1]] * [1, 1, 0.9] + [0.03, 0.021, 0]]),
        [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
        process=False,
    )
    with pytest.raises(RadarError, match="touch or cross without common edges"):
        sweep(body(cross, full_wave="on"), np.array([20.0]))
    assert sweep(body(cross), np.array([20.0])).currents is None


def test_images_refuse_the_switch() -> None:
    with pytest.raises(SceneError, match="full_wave = on is of rcs alone"):
        render(body(trimesh.creation.box((0.8, 0.6, 0.5)), full_wave="on"))


@pytest.mark.filterwarnings("ignore:.*of round metal")  # so they are, where they are too large to be solved
@pytest.mark.parametrize(
    "seeds", [(15,), pytest.param(range(40), marks=pytest.mark.slow)], ids=["one", "forty"]
)
def test_drawn_meshes_of_spheres_are_within_their_statements(
    benchmark_script: Callable[[str], ModuleType], seeds: Sequence[int]
) -> None:
    """Meridians, icospheres, scans with noise, hulls, bodies of revolution at ka 0.5 to 30 against the Mie series."""
    study = benchmark_script("small_round_bodies")
    for seed in seeds:
        name, true, stated, text = study.stated_of_sphere(seed)
        assert true < stated + 3.0, (name, text)
