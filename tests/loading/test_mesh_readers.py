"""Readers of OBJ and serialized meshes, against readers that share no code with them, and what they refuse."""

import base64
import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sarmitsuba.core.errors import DataError, SceneError
from sarmitsuba.loading import maps
from sarmitsuba.loading.mesh_files import obj_materials, read_mesh, read_parts, read_shape
from sarmitsuba.machine.backend import mi
from sarmitsuba.scene.mesh.formats import read_obj, read_serialized


def serialized(version: int, flags: int, rng: np.random.Generator) -> tuple[bytes, NDArray, NDArray]:
    """One shape, its vertices and its faces."""
    kind = "<f8" if flags & 0x2000 else "<f4"
    n, m = int(rng.integers(3, 30)), int(rng.integers(1, 40))
    places = rng.normal(size=(n, 3)).astype(kind)
    beside = sum(k for flag, k in ((1, 3), (2, 2), (8, 3)) if flags & flag)
    faces = rng.integers(0, n, (m, 3)).astype("<u4")
    name = b"a name\0" if version == 4 else b""
    body = struct.pack("<I", flags) + name + struct.pack("<QQ", n, m) + places.tobytes()
    body += rng.normal(size=(n, beside)).astype(kind).tobytes() + faces.tobytes()
    return struct.pack("<HH", 0x041C, version) + zlib.compress(body), places, faces


@pytest.mark.parametrize("version", [3, 4])
def test_serialized_meshes_are_what_mitsuba_reads(tmp_path: Path, version: int) -> None:
    rng = np.random.default_rng(version)
    path, offsets, whole, shapes = tmp_path / "m.serialized", [], b"", []
    for flags in (0x1000, 0x2000, 0x1003, 0x200B, 0x1008, 0x1010):
        part, places, faces = serialized(version, flags, rng)
        offsets.append(len(whole))
        whole += part
        shapes.append((places, faces))
    form = f"<{len(offsets)}{'Q' if version == 4 else 'I'}I"
    path.write_bytes(whole + struct.pack(form, *offsets, len(offsets)))
    for index, (places, faces) in enumerate(shapes):
        vertices, corners = read_serialized(path, index)
        np.testing.assert_array_equal(vertices, places.astype(np.float64))
        np.testing.assert_array_equal(corners, faces)
        mesh = mi.traverse(mi.load_dict({"type": "serialized", "filename": str(path), "shape_index": index}))
        theirs = np.array(mesh["vertex_positions"]).reshape(-1, 3)
        np.testing.assert_array_equal(theirs, vertices.astype(np.float32))
        np.testing.assert_array_equal(np.array(mesh["faces"]).reshape(-1, 3), corners)
    with pytest.raises(ValueError, match="shape_index = 6, but the file has 6 shapes"):
        read_serialized(path, 6)


@pytest.mark.parametrize(("vertices", "faces"), [(10**6, 10**6), (2**62, 1), (3, 2**40)])
def test_serialized_meshes_that_claim_too_much_are_refused(tmp_path: Path, vertices: int, faces: int) -> None:
    body = struct.pack("<I", 0x1000) + b"\0" + struct.pack("<QQ", vertices, faces)
    (tmp_path / "m.serialized").write_bytes(
        struct.pack("<HH", 0x041C, 4) + zlib.compress(body + bytes(10**6))
    )
    with pytest.raises(SceneError, match=r"claims to unpack to .* MB"):
        read_shape(tmp_path / "m.serialized", 0, "scene")


def test_obj_files_are_what_trimesh_reads(tmp_path: Path) -> None:
    """Drawn files of triangles, with materials, objects, texture coordinates and numbers from the end."""
    import trimesh

    for seed in range(20):
        rng, path, rows, faces, names, count = np.random.default_rng(seed), tmp_path / "m.obj", [], [], [], 0
        name = ""
        for _ in range(int(rng.integers(2, 20))):
            if rng.random() < 0.4:
                name = f"m {rng.integers(3)}"
                rows.append(f"usemtl  {name}")
            for _ in range(3):
                rows.append("v " + " ".join(f"{x:.9g}" for x in rng.normal(size=3)))
            count += 3
            corner = rng.permutation(count)[:3]
            back = seed % 2 and rng.random() < 0.3  # trimesh counts them from the end of the file
            said = [f"{k - count if back else k + 1}" for k in corner]
            rows.append("f " + (" \\\n" if rng.random() < 0.1 else " ").join(said))
            faces.append(corner)
            names.append(name)
        path.write_text("\n".join(rows))
        vertices, read = read_mesh(path, "scene")
        np.testing.assert_array_equal(read, faces)
        if seed % 2 == 0:
            theirs = trimesh.load(
                path, force="mesh", process=False, skip_materials=True, group_material=False
            )
            mine = np.sort(vertices[read].reshape(-1, 9), axis=0)
            np.testing.assert_array_equal(mine, np.sort(theirs.triangles.reshape(-1, 9), axis=0))
        assert obj_materials(path) == read_obj(path).materials
        for part in read_parts(path, "scene"):
            own = [f for f, used in zip(faces, names, strict=True) if used == part.material]
            np.testing.assert_array_equal(part.vertices[part.faces], vertices[np.array(own)])
            assert len(np.unique(part.faces)) == len(part.vertices)


def test_obj_polygons_are_fans_and_bad_numbers_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.obj"
    corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv -1 0 0\n"
    path.write_text(corners + "f 1/1 2//2 3/3/3 4\nf 1 2\nf 1 2 3 4 -1\n")
    faces = [[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [0, 3, 4]]
    np.testing.assert_array_equal(read_obj(path).faces, faces)
    for row in (
        "f 1 2 0",
        "f 1 2 6",
        "f 1 2 -6",
        "f 1 2 x",
        "f 1 2 " + "9" * 30,
        "f 1 2 " + "9" * 9000,
        "v 1 2",
    ):
        path.write_text(corners + row)
        with pytest.raises(SceneError, match=r"m\.obj is malformed"):
            read_mesh(path, "scene")


def test_channels_of_openexr_maps_count(tmp_path: Path) -> None:
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    plane = np.zeros((500, 500), np.float32)
    OpenEXR.File(header, {f"c{i:03d}": plane for i in range(300)}).write(str(tmp_path / "m.exr"))
    with pytest.raises(SceneError, match="claims to unpack to 300 MB"):
        maps._check_size(tmp_path / "m.exr", "scene")


def test_planes_that_deflate_a_thousand_to_one_are_refused(tmp_path: Path) -> None:
    import h5py

    from sarmitsuba.files.catalog import hdf5

    with h5py.File(tmp_path / "raw.h5", "w") as file:
        row = np.zeros(1 << 20, np.complex64)
        made = file.create_dataset(
            "echoes/VV", (40, row.size), row.dtype, chunks=(1, row.size), compression=9
        )
        for i in range(40):
            made.id.write_direct_chunk((i, 0), zlib.compress(row.tobytes(), 9))
        with pytest.raises(DataError, match=r"claims to unpack to 335\.544 MB"):
            hdf5._read_planes(file, hdf5._ECHOES, True)
        file["layers"] = ["/echoes/VV"] * 3
        with pytest.raises(DataError, match="names a plane twice"):
            hdf5._read_planes(file, hdf5._ECHOES, True)


def test_materials_that_differ_in_name_alone_share_their_tables() -> None:
    """And errors name the material that is asked for."""
    from sarmitsuba.scene.materials.diffuse import diffuse_tables
    from sarmitsuba.scene.materials.material import Material

    a, b = (
        Material(
            name, permittivity=5.0, rms_height=0.01, correlation_length=0.1, diffuse_law="small_perturbation"
        )
        for name in "ab"
    )
    one, two = diffuse_tables(a, 0.03), diffuse_tables(b, 0.03)
    np.testing.assert_array_equal(one.amplitude_h, two.amplitude_h)
    assert [note.replace('"a"', '"b"') for note in one.notes] == list(two.notes)


def _write_gltf(path: Path, parents: list[int], places: NDArray[np.float64]) -> None:
    """A triangle at every node; node 0 is the root, and every other one a child of an earlier one."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()
    data = base64.b64encode(corners + np.array([0, 1, 2, 0], np.uint16).tobytes()).decode()
    nodes: list[dict[str, object]] = [
        {"name": f"n{i}", "mesh": 0, "translation": place.tolist()} for i, place in enumerate(places)
    ]
    for child, parent in enumerate(parents, 1):
        nodes[parent].setdefault("children", []).append(child)  # type: ignore[attr-defined]
    accessors: list[dict[str, object]] = [
        {
            "bufferView": 0,
            "componentType": 5126,
            "count": 3,
            "type": "VEC3",
            "min": [0, 0, 0],
            "max": [1, 1, 0],
        },
        {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
    ]
    views = [
        {"buffer": 0, "byteOffset": 0, "byteLength": 36},
        {"buffer": 0, "byteOffset": 36, "byteLength": 6},
    ]
    whole = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": 44, "uri": f"data:application/octet-stream;base64,{data}"}],
    }
    path.write_text(json.dumps(whole))


@pytest.mark.parametrize("count", [2, 40, 900])
@pytest.mark.parametrize("chain", [True, False])
def test_nodes_of_gltf_lie_where_their_parents_put_them(tmp_path: Path, count: int, chain: bool) -> None:
    """A chain of 100 nodes took 9.7 s, and one of 2,000 did not end: every node went up to the root."""
    rng = np.random.default_rng(count)
    parents = [i if chain else int(rng.integers(i + 1)) for i in range(count - 1)]
    places = rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32).astype(np.float64)
    _write_gltf(tmp_path / "a.gltf", parents, places)
    world = places.copy()
    for child, parent in enumerate(parents, 1):
        world[child] += world[parent]
    found = {part.name: part.vertices[0] for part in read_parts(tmp_path / "a.gltf", "a")}
    assert len(found) == count
    # tol: float64 sums of up to 900 numbers of at most 1
    np.testing.assert_allclose([found[f"n{i}"] for i in range(count)], world, atol=1e-11)


def test_chains_of_nodes_without_end_are_refused(tmp_path: Path) -> None:
    _write_gltf(tmp_path / "a.gltf", list(range(1999)), np.zeros((2000, 3)))
    with pytest.raises(SceneError, match="more than 1000 within each other"):
        read_parts(tmp_path / "a.gltf", "a")


def test_gltf_nested_too_deeply_is_refused_by_its_reason(tmp_path: Path) -> None:
    """Trimesh itself would look for a file whose name is the text."""
    path = tmp_path / "deep.gltf"
    path.write_text('{"asset": {"version": "2.0"}, "x": ' + "[" * 100_000 + "]" * 100_000 + "}")
    with pytest.raises(SceneError, match=r"deep\.gltf is malformed: its entries are nested too deeply"):
        read_parts(path, "scene")


TWO_HOUSES = """o Haus 1
v 0 0 0
v 10 0 0
v 10 0 8
v 0 9 8
usemtl brick
f 1 2 3
usemtl tiles
f 1 3 4
o Haus 2/alt
usemtl brick
f 2 3 4
o Haus 3
usemtl brick
f 1 2 4
"""


@pytest.mark.parametrize("mark", ["o", "g"])
def test_parts_of_obj_files_are_objects_by_material(tmp_path: Path, mark: str) -> None:
    """They were joined by material: a town had no houses."""
    (tmp_path / "town.obj").write_text(TWO_HOUSES.replace("o Haus", f"{mark} Haus"))
    parts = read_parts(tmp_path / "town.obj", "town")
    assert [(p.name, p.whole, p.material) for p in parts] == [
        ("Haus 1/brick", "Haus 1", "brick"),
        ("Haus 1/tiles", "Haus 1", "tiles"),
        ("Haus 2 alt", "Haus 2 alt", "brick"),
        ("Haus 3", "Haus 3", "brick"),
    ]


def test_primitives_of_a_gltf_node_are_parts_of_one_object(tmp_path: Path) -> None:
    """Their names had random ends, so that each reading named and ordered them anew."""
    path = tmp_path / "a.gltf"
    _write_gltf(path, [0, 1], np.zeros((3, 3)))
    whole = json.loads(path.read_text())
    whole["meshes"][0]["primitives"] = [
        {**whole["meshes"][0]["primitives"][0], "material": m} for m in (0, 1)
    ]
    whole["materials"] = [{"name": "tin"}, {"name": "brick"}]
    path.write_text(json.dumps(whole))
    parts = read_parts(path, "a")
    assert [(p.name, p.whole) for p in parts] == [
        (f"n{i}/{material}", f"n{i}") for i in range(3) for material in ("tin", "brick")
    ]
