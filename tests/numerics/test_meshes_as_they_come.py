"""Meshes with every defect of real files: cleaned or refused, and the same image whatever their faces' order."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SceneError
from sarmitsuba.machine.backend import mi
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.cleaning import clean_mesh
from sarmitsuba.scene.mesh.formats import write_ply
from sarmitsuba.scene.mesh.smooth_groups import smooth_groups
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth.validation.targets import PEC, geometry, parallelogram
from tests.support.paths import aimed_at, record_paths

FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY
LOOKS = [[0.0, 0.0, 1.0], [0.1, 0.03, 1.0], [0.7, 0.2, 1.0]]
PLATE = parallelogram([-0.5, -0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])


def amplitude(vertices: np.ndarray, faces: np.ndarray, looks: list[list[float]] = LOOKS) -> np.ndarray:
    """Far-field amplitudes of a mesh after cleaning, as the loader does it."""
    v, f, _ = clean_mesh("mesh", vertices, faces)
    target = replace(geometry([(v, f)]), face_group=smooth_groups(v, f))
    return monostatic_rcs(target, PEC, looks, FREQUENCY, max_depth=2, ray_spacing=0.01).amplitude[:, 0]


def change(got: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.abs(got - wanted).max() / np.abs(wanted).max())


def fan_of_slivers(n: int) -> tuple[np.ndarray, np.ndarray]:
    """The plate as a fan from one corner: n triangles along two sides, the thinnest 1 / n high."""
    t = np.linspace(-0.5, 0.5, n // 2 + 1)
    side = np.concatenate(
        [np.column_stack([0 * t + 0.5, t]), np.column_stack([t[::-1], 0 * t + 0.5])[1:]]
    )  # from (0.5, -0.5) over (0.5, 0.5) to (-0.5, 0.5)
    v = np.zeros((side.shape[0] + 1, 3))
    v[0, :2], v[1:, :2] = -0.5, side
    i = np.arange(1, side.shape[0])
    return v, np.column_stack([0 * i, i, i + 1])


def test_slivers_zero_area_and_duplicate_faces(row) -> None:
    """A plate of 3 000 slivers, with flat faces, copies and flipped copies, returns what two triangles do.

    Naive way: the flat faces' normals are 0 / 0. Embree never reports such a face, so that the echo survives, but
    every table made from normals (smooth groups, edges of the pilot) holds NaN.
    """
    truth = amplitude(*PLATE)
    v, f = fan_of_slivers(3000)
    rng = np.random.default_rng(0)
    flat = np.stack([rng.integers(0, len(v), 500)] * 2 + [rng.integers(0, len(v), 500)], axis=1)
    dirty = np.concatenate([f, flat, f[:1000, [1, 2, 0]], f[1000:1900, ::-1]])
    dirty = dirty[rng.permutation(len(dirty))]
    cleaned, kept, notes = clean_mesh("plate", v, dirty)
    assert len(kept) == len(f)
    assert notes[0] == f'mesh "plate": removed 500 of {len(dirty)} faces without area'
    assert "1900 duplicate faces" in notes[1] and "flipped copies" in notes[1]

    def without_normal(v: np.ndarray, f: np.ndarray) -> float:
        cross = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
        return 100.0 * float(np.mean(np.linalg.norm(cross, axis=1) == 0))

    row(
        "plate of 3 000 slivers, 500 flat and 1 900 double faces: faces whose normal is NaN",
        without_normal(cleaned, kept),
        0.0,
        "%",
        naive=without_normal(v, dirty),
        remedy="flat and double faces removed, with a note of mesh and count",
    )
    # tol: float32 edges of slivers 0.3 mm high
    row("the same: change of its echo", change(amplitude(cleaned, kept), truth), 1e-3)


def test_flipped_faces_and_non_manifold_edges(row) -> None:
    """Half of the faces wound the other way, and a fin on an inner edge: surfaces are two-sided.

    Naive way: facets facing away culled: half the plate is missing, -6 dB.
    """
    v, f = parallelogram([-0.5, -0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 200)
    truth = amplitude(v, f)
    rng = np.random.default_rng(2)
    turned = f.copy()
    odd = rng.random(len(f)) < 0.5
    turned[odd] = turned[odd][:, ::-1]
    up = np.cross(v[turned[:, 1]] - v[turned[:, 0]], v[turned[:, 2]] - v[turned[:, 0]])[:, 2] > 0
    row(
        "plate with half of its faces flipped: change of its echo",
        change(amplitude(v, turned), truth),
        1e-6,
        naive=change(amplitude(v, turned[up]), truth),
        remedy="normals face the ray",
    )
    # three faces at one edge: two of the sheet and a fin, seen edge-on from above
    fin = np.concatenate([v, [[0.5 * (v[f[0, 0], 0] + v[f[0, 1], 0]), v[f[0, 0], 1], -0.2]]])
    faces = np.concatenate([f, [[f[0, 0], f[0, 1], len(v)]]])
    above = [[0.0, 0.0, 1.0]]
    # tol: the fin moves the window's centre, and with it the lattice against the rim
    row(
        "non-manifold edge, a fin below the plate: change of its echo from above",
        change(np.abs(amplitude(fin, faces, above)), np.abs(amplitude(v, f, above))),
        1e-3,
    )


def test_t_junctions(row) -> None:
    """A vertex in the middle of a neighbour's edge, where float32 leaves a crack: no ray falls through.

    Naive way: Embree's own answer; rays aimed at the junction lines slip through.
    """
    third = 1.0 / 3.0
    v = np.array(
        [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5], [third - 0.5, 0.03], [-0.5, 0.03], [0.5, 0.03]]
    )
    v = np.column_stack([v, 0.31 * v[:, 0] + 0.17 * v[:, 1] + 0.7])
    # the lower half is one quad along y = 0.03; the upper half has a vertex in the middle of that edge
    faces = np.array([[0, 1, 6], [0, 6, 5], [5, 4, 3], [4, 6, 2], [4, 2, 3]])
    target = geometry([clean_mesh("t", v, faces)[:2]])
    t = np.linspace(0.001, 0.999, 20_001)[:, None]
    seam = v[5] * (1 - t) + v[6] * t
    look = np.array([0.3, 0.1, 1.0]) / np.linalg.norm([0.3, 0.1, 1.0])
    antenna = 1e4 * look
    frame, grid = aimed_at(seam, antenna)
    lost = int((record_paths(target, PEC, antenna, frame, grid, FREQUENCY, max_depth=1).hits == 0).sum())
    row(
        "rays aimed along a T-junction: lost",
        100.0 * lost / len(seam),
        0.0,
        "%",
        remedy="a second try beside",
    )
    plain = np.array([[0, 1, 2], [0, 2, 3]])
    normal = np.cross(v[1] - v[0], v[3] - v[0])
    looks = [list(normal), *LOOKS]
    row(
        "plate with a T-junction: change of its echo",
        change(amplitude(v, faces, looks), amplitude(v, plain, looks)),
        1e-4,
    )


def overlapping_walls(order: np.ndarray | None = None) -> Geometry:
    """Two coplanar walls of different materials that overlap by half, as in real city models."""
    left = parallelogram([-0.5, -0.5, 0.0], [0.7, 0.0, 0.0], [0.0, 1.0, 0.0], 50)
    right = parallelogram([-0.2, -0.5, 0.0], [0.7, 0.0, 0.0], [0.0, 1.0, 0.0], 72)
    both = geometry([left, right], [0, 1])
    if order is None:
        return both
    return replace(
        both,
        faces=both.faces[order],
        face_material=both.face_material[order],
        face_group=both.face_group[order],
    )


def echo_in_file_order(scene: "mi.Scene", walls: Geometry, materials: tuple[Material, ...]) -> complex:
    """Sum of the reflection coefficients that rays along -z find with the faces as they are listed."""
    x, y = (a.ravel().astype(np.float32) for a in np.meshgrid(*[np.arange(-0.5, 0.5, 0.01) + 0.0037] * 2))
    ray = mi.Ray3f(mi.Point3f(mi.Float(x), mi.Float(y), 1.0), mi.Vector3f(0.0, 0.0, -1.0))
    found = scene.ray_intersect_preliminary(ray)
    face = found.prim_index.numpy()[found.is_valid().numpy()]
    root = np.sqrt([complex(m.permittivity) for m in materials])
    coefficient = np.where([m.pec for m in materials], -1.0, (1.0 - root) / (1.0 + root))
    return complex(coefficient[walls.face_material[face]].sum())


def test_overlapping_coplanar_walls_do_not_depend_on_face_order(row, plain_scene) -> None:
    """Which of two coinciding faces a ray hits must not hang on how the file lists them.

    Naive way: faces handed to Embree in file order; the echo of the overlap changes by a tenth with every shuffle.
    Plain Mitsuba stands for it: rays from above, and the reflection coefficient of the face that each finds.
    """
    materials = (Material("glass", permittivity=6.3 - 0.1j), Material("metal", pec=True))
    n = overlapping_walls().n_faces
    orders = [None, np.arange(n)[::-1], *(np.random.default_rng(i).permutation(n) for i in range(3))]

    got = [
        monostatic_rcs(
            overlapping_walls(o), materials, LOOKS, FREQUENCY, max_depth=1, ray_spacing=0.01
        ).amplitude[:, 0]
        for o in orders
    ]
    listed = [overlapping_walls(o) for o in orders]
    naive = np.array([echo_in_file_order(plain_scene(walls), walls, materials) for walls in listed])
    # tol: float32 sums in the order of the threads
    row(
        "coplanar overlapping walls of two materials: change of the echo with the order of faces",
        max(change(g, got[0]) for g in got[1:]),
        1e-5,
        naive=float(np.abs(naive - naive[0]).max() / abs(naive[0])),
        remedy="faces sorted by place and material before they are traced",
    )


def test_one_triangle(row) -> None:
    """A single triangle at normal incidence: 4 pi A^2 / lambda^2."""
    v = np.array([[0.0, 0.0, 0.0], [0.8, 0.1, 0.0], [0.2, 0.7, 0.0]])
    area = 0.5 * abs(0.8 * 0.7 - 0.1 * 0.2)
    got = 20 * np.log10(abs(amplitude(v, np.array([[0, 1, 2]]), [[0.0, 0.0, 1.0]])[0, 0]))
    error = abs(got - 20 * np.log10(2 * np.sqrt(np.pi) * area / WAVELENGTH))
    # tol: rim resolved to a third of a wavelength
    row("one triangle at normal incidence", error, 0.05, "dB")


@pytest.mark.parametrize("n", [200, pytest.param(708, marks=pytest.mark.slow)])
def test_as_many_triangles_as_a_million(n: int, row) -> None:
    """The plate in 80 000 or 10^6 triangles of 1.4 mm: cleaned, grouped, traced, the same echo."""
    x = np.linspace(-0.5, 0.5, n + 1)
    v = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((n + 1, n + 1))], axis=-1).reshape(-1, 3)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    f = np.concatenate([np.column_stack([a, a + n + 1, a + n + 2]), np.column_stack([a, a + n + 2, a + 1])])
    # tol: float32 of the sides' offsets; every triangle has the sides of the whole plate
    row(
        f"plate in {len(f)} triangles: change of its echo",
        change(amplitude(v, f), amplitude(*PLATE)),
        1e-6,
    )


PLY_SCENE = (
    '<scene version="3.0.0"><sensor type="sar_antenna"/><shape type="ply" id="roof"><string name="filename" '
    'value="roof.ply"/><bsdf type="radar_material"><string name="material" value="pec"/></bsdf></shape></scene>'
)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (
            [[0, 0, 0], [1, 0, 0], [0, np.nan, 0], [1, 1, np.inf]],
            [[0, 1, 2], [1, 3, 2]],
            "2 of 4 vertices are NaN",
        ),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "all 1 faces have zero area"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.zeros((0, 3), int), "holds no faces"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 7]], "refers to vertex 7 of 3"),
        ([[0, 0, 0], [1e12, 0, 0], [0, 1, 0]], [[0, 1, 2]], "coordinate 1e+12 m lies beyond 1e+09 m"),
    ],
    ids=["not finite", "flat", "empty", "index", "units"],
)
def test_hopeless_meshes_are_refused_by_name_and_count(
    tmp_path: Path, vertices: list, faces: list, message: str
) -> None:
    write_ply(tmp_path / "roof.ply", np.array(vertices, dtype=float), np.array(faces))
    (tmp_path / "scene.xml").write_text(PLY_SCENE)
    with pytest.raises(SceneError) as caught:
        sarmitsuba.load_scene(tmp_path / "scene.xml")
    text = str(caught.value)
    assert message in text and "roof" in text and text.startswith("scene.xml: ") and "\n" not in text


def test_repairs_are_noted_with_the_scene(tmp_path: Path) -> None:
    """What is removed on loading stands in the scene's notes, with the mesh and the count."""
    v = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    write_ply(tmp_path / "roof.ply", v, [[0, 1, 2], [0, 2, 3], [0, 3, 2], [0, 1, 1]])
    (tmp_path / "scene.xml").write_text(PLY_SCENE)
    scene = sarmitsuba.load_scene(tmp_path / "scene.xml")
    assert scene.geometry.n_faces == 2
    assert 'scene.xml: mesh "roof": removed 1 of 4 faces without area' in scene.notes
    assert any('mesh "roof": removed 1 duplicate faces of 4 (1 flipped copies)' in n for n in scene.notes)
