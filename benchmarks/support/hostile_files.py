"""Undamaged files of every kind, and damage drawn without regard to their structure: text and bytes."""

import base64
import json
import random
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from sarmitsuba.apps.cost_trials import TrialSetting
    from sarmitsuba.apps.dataset_draw import Drawer
    from sarmitsuba.scene.scene import Scene

SCENE = """<scene version="3.0.0">
<default name="look" value="40"/>
<integrator type="sar_path"><integer name="max_depth" value="2"/></integrator>
<sensor type="sar_antenna" id="radar"><float name="slant_range" value="1000"/><integer name="n_pulses" value="8"/>
  <float name="look_angle_deg" value="$look"/><string name="polarisation" value="HH,VV"/>
  <film type="range_film"><float name="image_extent_range" value="8"/></film></sensor>
<bsdf type="radar_material" id="m"><string name="material" value="concrete"/>
  <float name="rms_height" value="0.001"/></bsdf>
<shape type="cube" id="c"><transform name="to_world"><scale x="2" y="3" z="1"/></transform><ref id="m"/></shape>
<shape type="ply"><string name="filename" value="mesh.ply"/><ref id="m"/></shape>
<shape type="sphere"><point name="center" x="0" y="0" z="2"/><bsdf type="point_scatterer">
  <float name="rcs_dbsm" value="10"/></bsdf></shape>
</scene>"""
SCENE_WITH_FILES = """<scene version="3.0.0">
<default name="look" value="40"/>
<include filename="part.xml"/>
<integrator type="sar_path"/>
<sensor type="sar_antenna"><float name="look_angle_deg" value="$look"/><integer name="n_pulses" value="8"/>
  <film type="range_film"/></sensor>
<bsdf type="diffuse" id="d"><spectrum name="reflectance" filename="reflectance.spd"/></bsdf>
<bsdf type="radar_material" id="m"><string name="material" value="concrete"/>
  <string name="diffuse_law" value="lambert"/><texture type="bitmap" name="sigma0_map">
  <string name="filename" value="grey.png"/></texture>
  <string name="map_extent" value="-3 -2 3 2"/><string name="sigma0_map_range" value="-10 5"/></bsdf>
<shape type="ply"><string name="filename" value="mesh.ply"/><ref id="m"/></shape>
<shape type="sphere"><ref id="d"/></shape>
</scene>"""
BOMB = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10 if i else "haha" * 10}">' for i in range(12))
TOKENS = (
    *(
        "0",
        "-1",
        "1e400",
        "nan",
        "inf",
        "-inf",
        "1e-320",
        "",
        "abc",
        "$n",
        "1" * 30,
        "9" * 400,
        "1,2,3",
        "-0",
        "1e308",
    ),
    *(
        "x" * 5000,
        "../" * 2000 + "x",
        "/dev/zero",
        "/dev/stdin",
        "/etc/passwd",
        "é",
        "\x00",
        "\n",
        "&e11;",
        "&x;",
        "]]>",
    ),
    *(
        "<",
        "&",
        "'",
        '"',
        "<!--",
        "4294967296",
        "2147483648",
        "18446744073709551615",
        "1e18",
        "true",
        "%s",
        "{}",
    ),
)
INSERTIONS = (
    f"<!DOCTYPE a [{BOMB}]>",
    '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
    '<!DOCTYPE a SYSTEM "file:///etc/passwd">',
    '<include filename="/dev/zero"/>',
    '<include filename="../../etc/passwd"/>',
    '<shape type="ply"><string name="filename" value="/dev/zero"/></shape>',
    f"<{'y' * 5000}/>",
)


PASSES_SHAPE = (12, 16)  # pulses and samples of the passes among the samples


def mutate_text(rng: random.Random, data: bytes) -> bytes:
    """One to six changes: values, lines, characters, cuts and insertions."""
    text = data.decode("utf-8", "surrogateescape")
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        kind = rng.choice(
            ("value", "value", "value", "insert", "line", "lines", "character", "cut", "end", "start")
        )
        at = rng.randrange(len(text) + 1)
        if kind == "value":
            end = at
            while at > 0 and text[at - 1] not in '\n\t",;<> ':
                at -= 1
            while end < len(text) and text[end] not in '\n\t",;<> ':
                end += 1
            text = text[:at] + rng.choice(TOKENS) + text[end:]
        elif kind == "insert":
            text = text[:at] + rng.choice((*TOKENS, *INSERTIONS)) + text[at:]
        elif kind == "start":
            text = rng.choice(INSERTIONS) + text
        elif kind == "character":
            text = text[:at] + chr(rng.randrange(1, 256)) + text[at + 1 :]
        elif kind == "cut":
            text = text[:at] + text[at + rng.choice((1, 3, 10, 60)) :]
        elif kind == "end":
            text = text[:at]
        else:
            lines = text.split("\n")
            i = rng.randrange(len(lines))
            if kind == "lines":
                lines[i:i] = [lines[i]] * rng.choice((1, 3, 1000))
            else:
                del lines[i]
            text = "\n".join(lines)
    return text.encode("utf-8", "surrogateescape")


def mutate_bytes(rng: random.Random, data: bytes) -> bytes:
    """One to eight changes: bytes, numbers of 2, 4 and 8 bytes, runs, cuts, and text where there is some."""
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3, 8))):
        if not found:
            break
        # heads hold the structure, and most of a file are samples
        at = rng.randrange(len(found)) if rng.random() < 0.4 else rng.randrange(min(len(found), 4000))
        kind = rng.choice(
            ("byte", "byte", "bit", "number", "number", "run", "cut", "grow", "end", "copy", "text")
        )
        if kind == "byte":
            found[at] = rng.randrange(256)
        elif kind == "bit":
            found[at] ^= 1 << rng.randrange(8)
        elif kind == "number":
            size = rng.choice((2, 4, 8))
            value = rng.choice((0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63, 2**64 - 1, 1000, 65535))
            number = (value % 256**size).to_bytes(size, rng.choice(("little", "big")))
            found[at : at + size] = number
        elif kind == "run":
            size = rng.randrange(1, 64)
            found[at : at + size] = bytes([rng.choice((0, 255))]) * size
        elif kind == "cut":
            del found[at : at + rng.choice((1, 8, 100))]
        elif kind == "grow":
            found[at:at] = rng.randbytes(rng.choice((1, 8, 100)))
        elif kind == "end":
            del found[at:]
        elif kind == "copy":
            other = rng.randrange(len(found))
            found[at : at + 32] = found[other : other + 32]
        else:
            found = bytearray(mutate_text(rng, bytes(found)))
    return bytes(found)


def make_samples(folder: Path) -> None:
    """Write one undamaged file of every kind."""
    import scipy.io
    import trimesh

    from sarmitsuba.files import write_image, write_raw
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.signal.raw_data import Layer
    from sarmitsuba.simulation.execution.passes import Passes
    from sarmitsuba.simulation.execution.render import simulate
    from tests.support.unweighted import focus

    folder.mkdir(parents=True, exist_ok=True)
    box = trimesh.creation.box()
    for name in ("mesh.ply", "mesh.stl", "mesh.obj", "mesh.glb"):
        box.export(folder / name)
    box.export(folder / "text.ply", encoding="ascii")
    (folder / "scene.xml").write_text(SCENE, encoding="utf-8")
    small = {"range_film.image_extent_azimuth": "4", "range_film.image_extent_range": "4"}
    raw = simulate(load_scene("point", parameters=small | {"slant_range": "1000", "azimuth_resolution": "2"}))
    image = focus(raw)
    for name in ("raw.h5", "raw.cphd"):
        write_raw(raw, folder / name)
    for name in ("image.h5", "image.nitf"):
        write_image(image, folder / name)
    angle = np.linspace(0.0, 0.05, 24)
    place = 7000.0 * np.stack([np.cos(angle), np.sin(angle), np.ones(24)])
    frequency = 9.6e9 + 1e6 * np.arange(32.0)
    fields = {
        "fp": np.ones((32, 24), np.complex64),
        "freq": frequency[:, None],
        "r0": np.linalg.norm(place, axis=0),
    }
    fields |= dict(zip("xyz", place[:, None], strict=True))
    scipy.io.savemat(folder / "raw.mat", {"data": fields})
    data = np.ones((1, *PASSES_SHAPE), np.complex64)
    history, levels = [(1.0, -20.0)], [0]
    passes = Passes("made here", 1, 1.0, data, (Layer("VV"),), history, dict(raw.metadata), levels, 1.0, 5)
    passes.save(folder / "passes.npz")
    track = [f"{i * 0.01},{i * 1.0},-5000,4000" for i in range(24)]
    (folder / "track.csv").write_text("time_s,x_m,y_m,z_m\n" + "\n".join(track), encoding="utf-8")
    a, rate = 7.0e6, 1.0e-3
    rows, items = [], []
    for t in np.arange(0.0, 80.0, 10.0):
        c, s = np.cos(rate * t), np.sin(rate * t)
        row = (a * c, 0.0, a * s, -a * rate * s, 0.0, a * rate * c)
        rows.append(",".join(f"{v:.6f}" for v in (t, *row)))
        tags = zip(("X", "Y", "Z", "VX", "VY", "VZ"), row, strict=True)
        numbers = "".join(f"<{tag}>{value:.6f}</{tag}>" for tag, value in tags)
        items.append(f"<OSV><UTC>UTC=2020-01-01T00:00:{int(t) % 60:02d}.0</UTC>{numbers}</OSV>\n")
    (folder / "vectors.csv").write_text("\n".join(rows), encoding="utf-8")
    whole = f"<Earth_Explorer_File>\n<Ref_Frame>EARTH_FIXED</Ref_Frame>\n{''.join(items[:6])}</Earth_Explorer_File>"
    (folder / "vectors.EOF").write_text(whole, encoding="utf-8")
    cut = [f"{axis},{angle},{-0.1 * angle**2}" for axis in ("azimuth", "elevation") for angle in range(-8, 9)]
    (folder / "pattern.csv").write_text("cut,angle_deg,gain_db\n" + "\n".join(cut), encoding="utf-8")
    _make_maps(folder)
    _make_scene_with_files(folder)
    _make_run(folder)
    _make_graph(folder)
    _make_journals(folder)
    (folder / "dictionary.txt").write_text("0", encoding="utf-8")


def _make_maps(folder: Path) -> None:
    """OpenStreetMap, CityGML, GeoJSON and an elevation raster: one building each, and a slope."""
    import rasterio

    places = [(11.57, 48.137), (11.5703, 48.137), (11.5703, 48.1372), (11.57, 48.1372)]
    nodes = "".join(f'<node id="{i}" lon="{x}" lat="{y}"/>' for i, (x, y) in enumerate(places, 1))
    inner = [(x * 0.5 + 11.57015 * 0.5, y * 0.5 + 48.1371 * 0.5) for x, y in places]
    nodes += "".join(f'<node id="{i}" lon="{x}" lat="{y}"/>' for i, (x, y) in enumerate(inner, 11))
    ways = "".join(
        f'<way id="{w}">{"".join(f"<nd ref={chr(34)}{i}{chr(34)}/>" for i in ids)}{tags}</way>'
        for w, ids, tags in (
            (
                1,
                (1, 2, 3, 4, 1),
                '<tag k="building" v="yes"/><tag k="height" v="12"/><tag k="roof:shape" v="gabled"/>',
            ),
            (2, (1, 2, 3), ""),
            (3, (3, 4, 1), ""),
            (4, (11, 12, 13, 14, 11), ""),
        )
    )
    relation = (
        '<relation id="1"><member type="way" ref="2" role="outer"/><member type="way" ref="3" role="outer"/>'
        '<member type="way" ref="4" role="inner"/><tag k="type" v="multipolygon"/><tag k="building" v="office"/>'
        '<tag k="building:levels" v="4"/><tag k="min_height" v="3"/></relation>'
    )
    (folder / "map.osm").write_text(f'<osm version="0.6">{nodes}{ways}{relation}</osm>', encoding="utf-8")
    feature = {
        "type": "Feature",
        "id": "way/1",
        "properties": {"building": "yes", "height": "12", "roof:shape": "hipped"},
        "geometry": {"type": "Polygon", "coordinates": [[*map(list, places), list(places[0])]]},
    }
    features = {"type": "FeatureCollection", "features": [feature]}
    (folder / "map.geojson").write_text(json.dumps(features), encoding="utf-8")
    corners = [(691000 + x, 5334000 + y, z) for z in (500, 507) for y in (0, 10) for x in (0, 20)]
    faces = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6))
    polygons = "".join(
        "<g:Polygon><g:exterior><g:LinearRing><g:posList>"
        + " ".join(f"{v:.3f}" for i in (*face, face[0]) for v in corners[i])
        + "</g:posList></g:LinearRing></g:exterior></g:Polygon>"
        for face in faces
    )
    spaces = 'xmlns:g="http://www.opengis.net/gml" xmlns:b="http://www.opengis.net/citygml/building/2.0"'
    (folder / "city.gml").write_text(
        f'<CityModel {spaces}><g:Envelope srsName="urn:ogc:def:crs:EPSG::25832"/><b:Building g:id="h1"><b:lod1Solid>'
        f"<g:Solid>{polygons}</g:Solid></b:lod1Solid></b:Building></CityModel>",
        encoding="utf-8",
    )
    heights = (500 + np.add.outer(np.arange(24.0), 0.5 * np.arange(32.0))).astype(np.float32)
    with rasterio.open(
        folder / "raster.tif", "w", driver="GTiff", width=32, height=24, count=1, dtype="float32", crs="EPSG:25832",
        transform=rasterio.Affine(10.0, 0.0, 691000.0, 0.0, -10.0, 5334000.0), compress="deflate", blockysize=8,
        nodata=-9999.0,
    ) as file:  # fmt: skip
        file.write(heights, 1)


def _make_scene_with_files(folder: Path) -> None:
    """A scene that names a file in every way there is."""
    import OpenEXR
    import trimesh
    from PIL import Image

    (folder / "reflectance.spd").write_text("400 0.5\n500 0.5\n700 0.6\n", encoding="utf-8")
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(folder / "grey.png")
    (folder / "part.xml").write_text('<scene version="3.0.0"><shape type="cube"/></scene>', encoding="utf-8")
    (folder / "files.xml").write_text(SCENE_WITH_FILES, encoding="utf-8")
    mapped = SCENE_WITH_FILES.replace("grey.png", "map.exr")
    (folder / "mapped.xml").write_text(mapped, encoding="utf-8")
    plane = np.linspace(0.0, 1.0, 64, dtype=np.float32).reshape(8, 8)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": plane}).write(str(folder / "map.exr"))
    (folder / "graph.json").write_text(
        json.dumps(
            {"s.xml": SCENE.replace("ply", "cube").replace('<string name="filename" value="mesh.cube"/>', "")}
        ),
        encoding="utf-8",
    )
    box = trimesh.creation.box()
    counts = struct.pack("<QQ", len(box.vertices), len(box.faces))
    body = struct.pack("<I", 0x1000) + b"box\0" + counts + box.vertices.astype("<f4").tobytes()
    packed = zlib.compress(body + box.faces.astype("<u4").tobytes())
    whole = struct.pack("<HH", 0x041C, 4) + packed + struct.pack("<QI", 0, 1)
    (folder / "mesh.serialized").write_bytes(whole)


def _make_run(folder: Path) -> None:
    """A folder of results."""
    from sarmitsuba import cli

    small = (
        "range_film.image_extent_azimuth=4",
        "range_film.image_extent_range=4",
        "sar_antenna.azimuth_resolution=2",
    )
    words = [word for text in (*small, "sar_antenna.slant_range=1000") for word in ("-D", text)]
    run = folder / "run"
    if cli.main(["render", "point", "-o", str(run), "--force", "--quiet", "--no-error-bars", *words]):
        raise RuntimeError("the scene of the results could not be rendered")


# ---- node graphs, journals, dictionaries -----------------------------------------------------------------------------

RECIPE = """
[dataset]
samples = 2
seed = 11
error_every = 4
licence = "CC0-1.0"
[images]
pixels_azimuth = 16
pixels_range = 16
[ground]
material = "asphalt"
[radar]
bandwidth = 200e6
azimuth_resolution = 1.0
[tracing]
method = "image"
"""


def resumed_scene() -> "Scene":
    """The scene of the journals."""
    from sarmitsuba.loading.load import load_scene

    small = {"range_film.image_extent_azimuth": "4", "range_film.image_extent_range": "4"}
    return load_scene(
        "dihedral", parameters=small | {"sar_antenna.slant_range": "1000", "azimuth_resolution": "1"}
    )


def resumed_setting() -> "TrialSetting":
    """The setting of the trial in a journal."""
    from sarmitsuba.apps.cost_trials import TrialSetting

    return TrialSetting({"method": "image", "max_depth": 2})


def sample_drawer(recipe: Path) -> "Drawer":
    """Drawer of the samples in a journal."""
    from sarmitsuba.apps.dataset_draw import Drawer

    if not recipe.is_file():
        recipe.write_text(RECIPE, encoding="utf-8")
    return Drawer.of(str(recipe))


def _make_graph(folder: Path) -> None:
    """A glTF file whose buffer is in it."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()
    data = base64.b64encode(corners + np.array([0, 1, 2, 0], np.uint16).tobytes()).decode()
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
    whole = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": accessors,
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 6},
        ],
        "buffers": [{"byteLength": 44, "uri": f"data:application/octet-stream;base64,{data}"}],
    }
    (folder / "nodes.gltf").write_text(json.dumps(whole), encoding="utf-8")


def _make_journals(folder: Path) -> None:
    """What an interrupted run, cost study and data set leave."""
    from sarmitsuba.apps.cost_trials import Trials, WorkClock
    from sarmitsuba.apps.dataset_recipe import PART_NAMES
    from sarmitsuba.apps.dataset_sample import make_sample
    from sarmitsuba.apps.dataset_store import SampleForm, append
    from sarmitsuba.machine.journal import Journal
    from sarmitsuba.simulation.execution.render import simulate

    scene = resumed_scene()
    simulate(scene, state=folder / "raw.blocks")
    trials = Trials(WorkClock(), folder / "cost.trials", "one")
    trials.run(scene, resumed_setting())
    trials.close()
    drawer = sample_drawer(folder / "small.toml")
    form = SampleForm(drawer.recipe.samples, PART_NAMES, drawer.classes, drawer.recipe.shape)
    journal = Journal(folder / "samples.journal", form)
    for number in range(drawer.recipe.samples):
        append(journal, make_sample(drawer, number))
    journal.close()


def drawn_dictionary(rng: random.Random, *, changed: bool = True) -> dict[Any, Any]:
    """A scene as a dict with one to four entries drawn anew."""
    from collections import OrderedDict
    from datetime import date
    from decimal import Decimal
    from fractions import Fraction
    from types import MappingProxyType

    from sarmitsuba.machine.backend import mi

    scene: dict[Any, Any] = {
        "type": "scene",
        "integrator": {"type": "sar_path"},
        "radar": {"type": "sar_antenna", "film": {"type": "range_film", "image_grid": "ground"}},
        "box": {"type": "cube", "bsdf": {"type": "radar_material", "material": "concrete"}},
        "ball": {"type": "sphere", "radius": 1.0, "center": [0.0, 0.0, 2.0]},
    }
    ring: dict[Any, Any] = {"type": "scene"}
    ring["x"] = ring
    deep: dict[Any, Any] = {"type": "cube"}
    for _ in range(rng.choice((10, 500, 3000))):
        deep = {"type": "scene", "x": deep}
    values: tuple[Any, ...] = (
        *(
            None,
            0,
            -1,
            True,
            1.5,
            float("nan"),
            float("inf"),
            10**400,
            2**63,
            -(2**64),
            1j,
            "x",
            b"x",
            "",
            "é",
            "\0",
            "x" * 10**6,
        ),
        *(
            [],
            (),
            [None],
            [1, 2, 3],
            (1.0, 2.0, 3.0),
            [[1, 2], [3]],
            ["a"],
            [10**400] * 3,
            {1, 2},
            frozenset(),
            range(3),
            object(),
        ),
        *(
            int,
            len,
            Path("x"),
            date(2020, 1, 1),
            Decimal(1),
            Fraction(1, 3),
            Exception("x"),
            NotImplemented,
            ...,
        ),
        *(
            np.float32(1),
            np.int64(-1),
            np.array(1.0),
            np.zeros(3),
            np.zeros((4, 4)),
            np.zeros(0),
            np.array([None]),
            np.array(["x"]),
        ),
        *(
            np.str_("x"),
            np.bytes_(b"x"),
            np.datetime64("2020"),
            np.zeros(2, "c8"),
            np.zeros(3, "f2"),
            np.ma.zeros(3),
        ),
        *(
            mi.ScalarPoint3f(1, 2, 3),
            mi.ScalarTransform4f(),
            mi.ScalarColor3f(1),
            mi.Float(1),
            mi.Point3f(1),
            mi.TensorXf([1.0]),
        ),
        *(
            {},
            {"type": None},
            {"type": 5},
            {"type": "cube"},
            {"type": "rgb", "value": None},
            {1: 2},
            {None: None},
            ring,
            deep,
        ),
        *(
            MappingProxyType({"type": "cube"}),
            OrderedDict(type="sphere"),
            mi.load_dict({"type": "sphere"}),
            memoryview(b"x"),
        ),
    )
    for _ in range(rng.choice((1, 1, 2, 4)) if changed else 0):
        places = [scene, *(value for value in scene.values() if isinstance(value, dict))]
        where = rng.choice(places)
        key: Any = rng.choice(
            (*where, "x", "to_world", "bsdf", "filename", "radius", "", "a.b", 5, None, (1,), b"k")
        )
        where[key] = rng.choice(values)
    return scene
