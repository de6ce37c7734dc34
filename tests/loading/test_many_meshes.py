"""Thousands of small meshes in few operations: the same as one after the other, and as general readers read them."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.mesh.cleaning import clean_mesh, clean_meshes
from sarmitsuba.scene.mesh.formats import read_ply, write_ply
from sarmitsuba.scene.mesh.smooth_groups import smooth_groups
from sarmitsuba.scene.mesh.tessellate import cube, cylinder, sphere

FLOATS = {"float": "<f4", "float32": "<f4", "double": "<f8"}


def drawn_mesh(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A body with copies, flipped copies, faces without area and unused vertices, at places shared with others."""
    v, f = [cube(), sphere(1.0, 0.1), cylinder(1.0, 0.0, 2.0, 0.05)][rng.integers(3)]
    extra = f[rng.integers(len(f), size=rng.integers(0, 6))]
    flat = np.stack([f[:, 0], f[:, 0], f[:, 1]], axis=1)[: rng.integers(0, 3)]
    faces = np.concatenate([f, extra, extra[:, ::-1][::2], flat])
    unused = rng.normal(size=(rng.integers(0, 4), 3))
    return np.concatenate([v, unused]), rng.permutation(faces).astype(rng.choice(["i4", "i8", "u4", "u8"]))


@pytest.mark.parametrize("seed", range(5))
def test_many_meshes_are_cleaned_and_grouped_as_each_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    meshes = [drawn_mesh(rng) for _ in range(12)]
    names = [f"m{i}" for i in range(len(meshes))]
    joined = clean_meshes(names, [v for v, _ in meshes], [f for _, f in meshes])
    groups = smooth_groups(joined.vertices, joined.faces, mesh=joined.mesh)
    notes, n_vertices, n_groups = [], 0, 0
    for i, (v, f) in enumerate(meshes):
        alone_v, alone_f, alone_notes = clean_mesh(names[i], v, f)
        here = joined.mesh == i
        np.testing.assert_array_equal(joined.faces[here] - n_vertices, alone_f)
        np.testing.assert_array_equal(joined.vertices[n_vertices : n_vertices + len(alone_v)], alone_v)
        alone_groups = smooth_groups(alone_v, alone_f)
        np.testing.assert_array_equal(groups[here] - n_groups, alone_groups)
        assert joined.repaired[i] == bool(alone_notes)
        notes += alone_notes
        n_vertices += len(alone_v)
        n_groups += alone_groups.max() + 1
    assert joined.notes == notes and notes
    assert n_vertices == len(joined.vertices)


def test_the_wrong_one_of_many_is_named() -> None:
    v, f = cube()
    bad = f.copy()
    bad[3, 1] = 99  # a vertex of the next mesh, were it not checked before they are joined
    with pytest.raises(SceneError, match=r'mesh "b": 1 of 12 faces have corners outside 0 ... 7'):
        clean_meshes(["a", "b", "c"], [v, v, v], [f, bad, f])
    with pytest.raises(SceneError, match='mesh "c": all 12 faces have zero area'):
        clean_meshes(["a", "b", "c"], [v, v, 0.0 * v], [f, f, f])


@pytest.mark.parametrize("seed", range(12))
def test_plain_files_are_read_as_trimesh_reads_them(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    v, f = drawn_mesh(rng)
    kind = rng.choice(list(FLOATS))
    extra = [("nx", kind), ("ny", kind), ("nz", kind), ("s", "float"), ("t", "float"), ("Col_0", kind)]
    extra += [("red", "uchar"), ("alpha", "uchar")]
    extra = extra[: rng.integers(0, len(extra) + 1)]
    types = [("x", FLOATS[kind]), ("y", FLOATS[kind]), ("z", FLOATS[kind])]
    types += [(name, "u1" if each == "uchar" else FLOATS[each]) for name, each in extra]
    rows = np.zeros(len(v), np.dtype(types))
    for k, axis in enumerate("xyz"):
        rows[axis] = v[:, k]
    faces = np.zeros(len(f), np.dtype([("n", "u1"), ("c", "<i4", (3,))]))
    faces["n"], faces["c"] = 3, f
    end = rng.choice(["\n", "\r\n"]) if not extra else "\n"
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += ["comment made here"] * int(rng.integers(0, 2))
    lines += [f"element vertex {len(v)}", *(f"property {kind} {a}" for a in "xyz")]
    lines += [f"property {each} {name}" for name, each in extra]
    lines += [f"element face {len(f)}", "property list uchar int vertex_indices", "end_header", ""]
    path = tmp_path / "mesh.ply"
    path.write_bytes(end.join(lines).encode() + rows.tobytes() + faces.tobytes())
    found = read_ply(path)
    assert found is not None
    general = trimesh.load_mesh(path, process=False, fix_texture=False)  # vertices as stored
    np.testing.assert_array_equal(found[0], np.asarray(general.vertices, dtype=np.float64))
    np.testing.assert_array_equal(found[1], general.faces)


def test_other_layouts_are_left_to_the_general_reader(tmp_path: Path) -> None:
    v, f = cube()
    path = tmp_path / "mesh.ply"
    write_ply(path, v, f)
    whole = path.read_bytes()
    assert read_ply(path) is not None
    others = {
        "cut": whole[:-1],
        "longer": whole + b"\0",
        "text": whole.replace(b"binary_little_endian", b"ascii"),
        "big": whole.replace(b"little", b"big"),
        "another order": whole.replace(b"double x", b"double q"),
        "a quad": whole[:-13] + b"\x04" + whole[-12:],
        "many vertices": whole.replace(b"vertex 8", b"vertex 9999999999"),
        "a coordinate twice": whole.replace(b"double z", b"double z\nproperty double z"),
        "one number too many": whole.replace(b"double z", b"double z\nproperty float s"),
        "empty": b"",
    }
    for name, content in others.items():
        path.write_bytes(content)
        assert read_ply(path) is None, name
