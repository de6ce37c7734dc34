"""What goes into a page: where echoes land, paths of a cell, mesh, packing, and what the command refuses."""

import base64
import gzip
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sarmitsuba import WireTarget, build_scene, load_scene
from sarmitsuba.cli import main
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.simulation.execution.path_table import trace_paths
from sarmitsuba.view.page.gltf import GRID, draw_scene, page_mesh
from sarmitsuba.view.page.paths import ORDERS, locate_on_plane, page_paths, pixels_of
from sarmitsuba.view.page.write import Packer, write_page


def test_points_of_the_plane_are_found_from_range_and_rate() -> None:
    """Drawn antennas, climbing ones too, and points on the side that they look to."""
    rng = np.random.default_rng(14)
    for _ in range(200):
        height = rng.normal(scale=100.0)
        position = np.array([*rng.normal(scale=1e4, size=2), height + rng.uniform(100.0, 7e5)])
        velocity = np.array([*rng.normal(scale=100.0, size=2), rng.normal(scale=20.0)])
        along = np.array([velocity[0], velocity[1], 0.0]) / np.hypot(velocity[0], velocity[1])
        across = np.array([along[1], -along[0], 0.0]) * rng.choice([-1.0, 1.0])
        ahead, beside = rng.normal(scale=5e3, size=4), rng.uniform(10.0, 5e4, size=4)
        points = position + ahead[:, None] * along + beside[:, None] * across
        points[:, 2] = height
        way = position - points
        distance = np.linalg.norm(way, axis=1)
        found = locate_on_plane(position, velocity, distance, way @ velocity / distance, height, across)
        # tol: at 700 km float64 keeps 1e-10 m, times slant over ground range, at most 1e5
        np.testing.assert_allclose(found, points, rtol=0.0, atol=1e-4)


def test_nearer_than_the_plane_is_nowhere() -> None:
    found = locate_on_plane(
        np.array([0.0, 0.0, 100.0]),
        np.array([0.0, 10.0, 0.0]),
        np.array([99.0]),
        np.zeros(1),
        0.0,
        np.array([1.0, 0, 0]),
    )
    assert np.isnan(found[0, :2]).all()


def test_paths_of_a_cell_are_those_that_trace_paths_finds_there() -> None:
    """In parts or at once: the same cells, the same paths, the same shares."""
    scene = load_scene(
        "tower", parameters={"sar_antenna.azimuth_resolution": "4", "sar_antenna.bandwidth": "60e6"}
    )
    grid = default_grid(scene.radar, scene.image)
    whole = page_paths(scene, grid, (2.0, 1.9), "VV", most=10_000)
    parts = page_paths(scene, grid, (2.0, 1.9), "VV", most=10_000, tile=9)
    for name in ("cell", "first", "found", "by_order"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name), err_msg=name)
    np.testing.assert_array_equal(whole.table.length, parts.table.length)
    np.testing.assert_array_equal(whole.share, parts.share)

    everything = trace_paths(scene)
    row, column = pixels_of(everything, scene, grid, scene.radar.track.center_index)
    strength = np.abs(everything.amplitude[:, 0])
    rng = np.random.default_rng(2)
    for place in rng.choice(whole.cell.size, 12, replace=False):
        i, j = divmod(int(whole.cell[place]), whole.shape[1])
        height, width = whole.cell_size
        inside = (np.floor((row + 0.5) / height) == i) & (np.floor((column + 0.5) / width) == j)
        assert inside.sum() == whole.found[place]
        kept = slice(whole.first[place], whole.first[place + 1])
        orders = np.bincount(np.minimum(everything.order[inside], ORDERS) - 1, strength[inside], ORDERS)
        # tol: shares are stored in steps of 1/255
        np.testing.assert_allclose(
            whole.by_order[place] / 255.0, orders / orders.sum(), rtol=0, atol=0.5 / 255 + 1e-9
        )
        strongest = strength[inside].max() / strength[inside].sum()
        assert whole.share[kept].max() == pytest.approx(strongest, rel=1e-6)
        assert set(whole.table.length[kept]) <= set(everything.length[inside])


def test_the_foot_of_the_tower_has_two_bounces() -> None:
    """Of the cells whose amplitude is mostly of two bounces, the brightest stand at the wall's foot, x = 0."""
    scene = load_scene("tower")
    grid = default_grid(scene.radar, scene.image)
    paths = page_paths(scene, grid, (0.4, 0.4), "VV")
    double = paths.by_order[:, 1] > 200
    assert double.sum() > 20
    column = (paths.cell[double] % paths.shape[1] + 0.5) * paths.cell_size[1]
    # the foot is the aim point's range, 10 km
    at = grid.range[0] + column * grid.range_spacing
    assert np.median(np.abs(at - 10000.0)) < 0.5


def test_mesh_travels_as_gltf() -> None:
    scene = load_scene("urban_block")
    geometry, center = scene.geometry, np.array([10.0, -20.0, 1.0])
    mesh = page_mesh(geometry, center)
    assert mesh.merged == 0.0 and mesh.n_faces == geometry.n_faces
    read = trimesh.load(io.BytesIO(mesh.glb), file_type="glb")
    for i, _ in enumerate(geometry.mesh_names):
        faces = geometry.faces[geometry.mesh_face_offset[i] : geometry.mesh_face_offset[i + 1]]
        corners = geometry.vertices[faces]
        area = (
            0.5
            * np.linalg.norm(
                np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
            ).sum()
        )
        parts = [part for name, part in read.geometry.items() if name.split("/")[0] == str(i)]
        # tol: vertices on a grid of a millimetre
        assert sum(part.area for part in parts) == pytest.approx(area, rel=2e-3)
    np.testing.assert_allclose(read.bounds, geometry.bounds - center, rtol=0.0, atol=GRID)


def test_large_meshes_are_merged_until_they_fit() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=3.0)
    n = len(sphere.faces)
    geometry = Geometry(
        np.asarray(sphere.vertices),
        np.asarray(sphere.faces, dtype=np.int32),
        np.zeros(n, dtype=np.int32),
        np.zeros(n, dtype=np.int32),
        ("ball",),
        np.array([0, n]),
    )
    mesh = page_mesh(geometry, np.zeros(3), most_faces=2000)
    assert 200 < mesh.n_faces <= 2000 and mesh.merged > 0.0
    read = trimesh.load(io.BytesIO(mesh.glb), file_type="glb")
    radius = np.linalg.norm(read.to_geometry().vertices, axis=1)
    # a vertex moves by half a cell's diagonal at most
    assert np.abs(radius - 3.0).max() <= 0.5 * np.sqrt(3.0) * mesh.merged


def test_arrays_are_packed_by_planes_of_bytes() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(5, 7)).astype(">f4")
    packer = Packer()
    reference = packer.pack({"some": [values, np.arange(3), "text"]})
    assert reference == {"some": [{"$": 0, "dtype": "float32", "shape": [5, 7]}, [0, 1, 2], "text"]}
    planes = np.frombuffer(gzip.decompress(base64.b64decode(packer.blobs[0])), dtype=np.uint8)
    back = planes.reshape(4, -1).T.tobytes()
    np.testing.assert_array_equal(np.frombuffer(back, dtype="<f4").reshape(5, 7), values)


def test_page_holds_all_that_it_needs(tmp_path: Path) -> None:
    """No address of another place is fetched, no import is left without a module, and names cannot break out."""
    write_page(tmp_path / "page.html", {"title": "</script><b>&", "looks": ["</script>"]})
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<b>&" not in text
    assert not re.findall(r"""(?:src|href)=["'](?!data:)""", text.split('<script type="importmap">')[0])
    imports = json.loads(re.search(r'<script type="importmap">(.*?)</script>', text).group(1))["imports"]
    for name, url in imports.items():
        code = base64.b64decode(url.partition(",")[2]).decode()
        code = re.sub(r"/\*.*?\*/", "", code, flags=re.DOTALL)
        wanted = re.findall(r"""(?:^|[;}\s])(?:import|export)[^;"']*?from\s*["']([^"']+)["']""", code)
        assert [one for one in wanted if one not in imports] == [], name


def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(tmp_path / "nothing")]) == 2
    (tmp_path / "parameters.json").write_text('{"command": "render"}')
    assert main(["view", str(tmp_path)]) == 2
    assert main(["render", "point", "-o", str(tmp_path / "out"), "--page", "--no-focus"]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert len(lines) == 3 and all(line.startswith("error: ") for line in lines)
    assert "parameters.json" in lines[0] and "no image" in lines[1] and "--no-focus" in lines[2]
    assert not (tmp_path / "page.html").exists()


def test_a_scene_that_changed_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["render", "point", "-o", str(out), "--quiet"]) == 0
    record = json.loads((out / "parameters.json").read_text())
    record["definitions"] = {"sar_antenna.slant_range": "9000"}
    (out / "parameters.json").write_text(json.dumps(record))
    assert main(["view", str(out), "--quiet"]) == 2
    assert "render it again" in capsys.readouterr().err


def test_images_without_pulses_and_data_without_a_scene_have_pages(tmp_path: Path) -> None:
    """Method image makes no raw data; focused raw data from elsewhere has no scene."""
    direct = tmp_path / "direct"
    assert main(["render", "dihedral", "-o", str(direct), "--method", "image", "--quiet", "--page"]) == 0
    assert (direct / "page.html").stat().st_size > 1e5
    whole = tmp_path / "whole"
    assert main(["render", "point", "-o", str(whole), "--quiet", "--no-focus"]) == 0
    (whole / "parameters.json").unlink()
    focused = tmp_path / "focused"
    assert main(["focus", str(whole / "raw.h5"), "-o", str(focused), "--quiet"]) == 0
    assert main(["view", str(focused), "--quiet"]) == 0
    text = (focused / "page.html").read_text(encoding="utf-8")
    facts = json.loads(re.search(r'id="payload">(.*?)</script>', text).group(1))
    assert facts["scenes"] == [] and facts["looks"][0]["paths"] is None


def test_rods_are_drawn_as_prisms() -> None:
    """One mesh of their own, around their lines, with a material that no face of the scene has."""
    wire = WireTarget("wire", np.array([0.0, 1.0, 0.0]), np.array([0.0, 1.0, 5.0]), 0.05)
    scene = build_scene(wires=[wire, WireTarget("wire", np.zeros(3), np.array([9.0, 0.0, 4.0]), 1e-4)])
    geometry, materials = draw_scene(scene)
    assert materials == ("metal wires",) and geometry.mesh_names == ("wires",)
    loaded = trimesh.load(io.BytesIO(page_mesh(geometry, np.zeros(3)).glb), file_type="glb")
    ((name, mesh),) = loaded.geometry.items()
    assert name == "0/0" and len(mesh.faces) == 12
    near = mesh.vertices[np.abs(mesh.vertices[:, 1] - 1.0) < 0.1]
    assert np.allclose(np.hypot(near[:, 0], near[:, 1] - 1.0), 0.05, atol=GRID)
