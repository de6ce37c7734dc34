import random
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

import sarmitsuba
from sarmitsuba import FilmDescription, Material, RadarDescription, TraceSettings, build_scene
from sarmitsuba.core.errors import RadarError, SarmitsubaError, SceneError
from sarmitsuba.loading.load import load_scene

PEC = '<bsdf type="radar_material" id="metal"><string name="material" value="pec"/></bsdf>'
GOOD = (
    '<scene version="3.0.0">\n<integrator type="sar_path"><integer name="max_depth" value="3"/></integrator>\n'
    '<sensor type="sar_antenna" id="radar"><float name="slant_range" value="9000"/>'
    '<film type="range_film"><integer name="gridding_width" value="4"/></film></sensor>\n'
    f'<shape type="rectangle" id="roof"><transform name="to_world"><scale x="2" y="3"/></transform>{PEC}</shape>\n'
    '<shape type="sphere" id="post"><point name="center" x="1" y="2" z="3"/><float name="radius" value="0.2"/>'
    '<ref id="metal"/></shape>\n</scene>\n'
)


def refused(folder: Path, text: str, **options: object) -> str:
    path = folder / "scene.xml"
    path.write_text(text, encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(SarmitsubaError) as caught:
            load_scene(path, **options)
    message = str(caught.value)
    assert "\n" not in message and "Traceback" not in message and ".cpp" not in message
    return message


def test_the_good_one_loads(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(GOOD, encoding="utf-8")
    assert load_scene(tmp_path / "scene.xml").settings.max_depth == 3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "</sensor>",
            "",
            "scene.xml (line 6, col 3): malformed XML: Start-end tags mismatch; check that every",
        ),
        (
            'value="9000"',
            'value="far"',
            'scene.xml (line 3, col 40): could not parse floating point value "far"',
        ),
        (
            'value="9000"',
            'value="$range"',
            "undefined parameter: $range; give it a <default> or -D range=value",
        ),
        (
            'value="9000"',
            'value="-1"',
            'scene.xml: sensor "radar": slant_range = -1 m is below the bound 1 m; give',
        ),
        (
            'value="9000"',
            'value="nan"',
            'scene.xml: sensor "radar": slant_range = nan is not a finite number; give',
        ),
        ("slant_range", "slantrange", 'unknown parameter "slantrange"; did you mean "slant_range"?'),
        (
            "gridding_width",
            "width",
            'scene.xml: film range_film (line 3): unknown parameter "width"; the image is',
        ),
        ("range_film", "hdrfilm", 'film type "hdrfilm" cannot record echoes; use range_film'),
        (
            'value="4"',
            'value="40"',
            "gridding_width = 40 is above the bound 8; give an integer from 2 to 8",
        ),
        (
            "max_depth",
            "depth",
            'integrator sar_path (line 2): unknown parameter "depth"; did you mean "max_depth"',
        ),
        (
            '"sar_antenna"',
            '"perspective"',
            "scene.xml: no sar_antenna sensor (only perspective); add one, or lay a",
        ),
        (
            'value="pec"',
            'value="peck"',
            'bsdf "metal": material = "peck" is not one of asphalt, asphalt_concrete, brick',
        ),
        ('id="metal"/>', 'id="mettle"/>', 'unresolved reference to "mettle"; did you mean "metal"?'),
        (
            '"rectangle"',
            '"rectangl"',
            'shape "roof": shape type "rectangl" is not supported; did you mean "rectan',
        ),
        ('"rectangle"', '"ply"', 'shape "roof": no mesh file is named; give <string name="filename"'),
        ('x="2" y="3"', 'value="0"', 'scene.xml: mesh "roof": all 2 faces have zero area; check its scale'),
        ('x="2" y="3"', 'value="1e308"', 'mesh "roof": coordinate 1e+308 m lies beyond 1e+09 m; check units'),
        ('x="2" y="3"', 'value="inf"', 'shape "roof": to_world is not a finite affine transform'),
        (
            'value="0.2"',
            'value="0"',
            'shape "post": radius = 0.0 m is not between 0 m and 1e9 m; give a positive',
        ),
        ('"radius"', '"radios"', 'shape "post": unknown parameter "radios"; did you mean "radius"?'),
        ('x="1" y="2"', 'x="nan" y="2"', 'shape "post": center = [nan 2. 3.] is not a finite point'),
        ('id="post"', 'id="roof"', 'duplicate ID: "roof"'),
        ('<integer name="max_depth"', '<integral name="max_depth"', "unsupported XML element: <integral>"),
        (' version="3.0.0"', "", "scene.xml: missing version attribute"),
    ],
)
def test_one_line_says_what_and_where(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    assert message in refused(tmp_path, GOOD.replace(old, new, 1))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"rang": "5"}, 'parameter "rang" = 5 is not used; the file has none'),
        ({"sar_path.max_dept": "5"}, 'unknown parameter "max_dept"; did you mean "max_depth"?'),
        ({"sarpath.max_depth": "5"}, 'no plugin or id "sarpath"; did you mean "sar_path"?'),
        ({"roof.scale": "5"}, '-D roof.scale=5: "roof" is a rectangle, whose values only the file changes'),
        ({"radar.prf": "fast"}, '-D radar.prf=fast: prf = "fast" is not of type float'),
        ({"filename": "a"}, 'parameter "filename": this name is reserved'),
    ],
)
def test_values_from_outside(tmp_path: Path, parameters: dict[str, str], message: str) -> None:
    assert message in refused(tmp_path, GOOD, parameters=parameters)


def test_missing_mesh_names_folder_and_file(tmp_path: Path) -> None:
    text = GOOD.replace(
        "</scene>", '<shape type="ply" id="hut"><string name="filename" value="no.ply"/></shape></scene>'
    )
    assert f'shape "hut": mesh file "no.ply" not found in {tmp_path}; check filename' in refused(
        tmp_path, text
    )


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", b"", "mesh file a.ply is malformed"),
        ("a.ply", b"not a ply at all", "mesh file a.ply is malformed"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n",
            "mesh file a.ply",
        ),
        ("a.obj", b"v 0 0 0\nv 1 0 0\n", "mesh file a.obj"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "mesh file a.obj"),
        ("a.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "1 of 3 vertices are NaN or infinite"),
        ("a.stl", b"solid\nfacet\n", "mesh file a.stl"),
        ("a.serialized", b"\x00\x01", "mesh file a.serialized is malformed"),
    ],
)
def test_broken_mesh_files(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    kind = name.partition(".")[2]
    bsdf = PEC.replace("metal", "m2")
    shape = f'<shape type="{kind}" id="hut"><string name="filename" value="{name}"/>{bsdf}</shape>'
    assert message in refused(tmp_path, GOOD.replace("</scene>", shape + "</scene>"))


def test_nothing_to_see(tmp_path: Path) -> None:
    start = GOOD.index("<shape")
    assert "the scene has no scatterers: there is no shape" in refused(tmp_path, GOOD[:start] + "</scene>")
    text = GOOD[:start] + '<shape type="cube"><bsdf type="null"/></shape></scene>'
    assert "the scene has no scatterers: every shape is invisible" in refused(tmp_path, text)


def test_shapes_do_not_belong_into_a_radar_file(tmp_path: Path) -> None:
    radar = tmp_path / "radar.xml"
    radar.write_text('<scene version="3.0.0"><shape type="cube" id="box"/></scene>', encoding="utf-8")
    assert "a radar file holds sensor, film and integrator only" in refused(tmp_path, GOOD, radar=radar)


def test_no_such_scene() -> None:
    with pytest.raises(SceneError, match=r'no shipped scene of that name; did you mean "dihedral"'):
        load_scene("dihedrl")


def test_unreadable_track(tmp_path: Path) -> None:
    text = GOOD.replace(
        '<float name="slant_range" value="9000"/>', '<string name="track_file" value="no.csv"/>'
    )
    assert "no.csv: cannot read the track: No such file" in refused(tmp_path, text)


@pytest.mark.parametrize("seed", [2, 3, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 1))])
def test_mutated_scenes_load_or_are_refused_in_one_line(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    path = tmp_path / "scene.xml"
    outcomes = {True: 0, False: 0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(100):
            path.write_bytes(mutate(GOOD, rng))
            try:
                load_scene(path)
                outcomes[True] += 1
            except (SceneError, RadarError) as error:
                assert "\n" not in str(error)
                outcomes[False] += 1
    assert outcomes[False] > 20  # the mutations are not all harmless


def mutate(text: str, rng: random.Random) -> bytes:
    """Change, drop, double or swap a few bytes, numbers or tags of a scene."""
    data = bytearray(text.encode())
    for _ in range(rng.randint(1, 3)):
        kind = rng.randrange(6)
        at = rng.randrange(len(data))
        if kind == 0:
            data[at] = rng.randrange(256)
        elif kind == 1:
            del data[at : at + rng.randint(1, 12)]
        elif kind == 2:
            data[at:at] = data[at : at + rng.randint(1, 40)]
        elif kind == 3:
            digits = [i for i, byte in enumerate(data) if chr(byte).isdigit()]
            if digits:
                data[rng.choice(digits)] = ord(rng.choice("0123456789-.e"))
        elif kind == 4:
            value = rng.choice(
                [b"nan", b"1e308", b"-1", b"0", b"", b"1e-300", b"99999999999", b"auto", b"$x"]
            )
            start = data.find(b'value="', at)
            if start >= 0:
                data[start + 7 : data.find(b'"', start + 7)] = value
        else:
            start = data.find(b"<", at)
            stop = data.find(b">", start)
            if start >= 0:
                del data[start : stop + 1]
        if not data:
            data = bytearray(b" ")
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("city.geojson", '{"type": "FeatureCollection"}', "it is"),
        ("town.osm", '<osm version="0.6"/>', "<osm> is"),
    ],
)
def test_files_of_cities_name_the_command_that_takes_them(
    tmp_path: Path, name: str, content: str, what: str
) -> None:
    (tmp_path / name).write_text(content, encoding="utf-8")
    stem = name.partition(".")[0]
    command = f"python -m sarmitsuba import {name} -o {stem}.xml"
    with pytest.raises(SceneError, match=rf"^{name}: {what} not a scene; .*{command}"):
        load_scene(tmp_path / name)


def test_a_scene_without_a_radar_names_the_shipped_ones(tmp_path: Path) -> None:
    text = re.sub(r"<sensor.*</sensor>", "", GOOD, flags=re.DOTALL)
    assert "--radar RADAR.xml or a shipped one: --radar airborne_ku, " in refused(tmp_path, text)


@pytest.mark.parametrize("call", [sarmitsuba.simulate, sarmitsuba.render, sarmitsuba.link_budget])
def test_functions_take_a_file_or_a_name(call: Callable[[object], object]) -> None:
    with pytest.raises(SceneError, match='no shipped scene of that name; did you mean "point"'):
        call("poin")
    with pytest.raises(
        SceneError, match=r"^scene: int is no scene; give a scene of load_scene or build_scene"
    ):
        call(3)


@pytest.mark.parametrize("call", [sarmitsuba.simulate, sarmitsuba.render])
def test_functions_take_what_loading_takes(call: Callable[..., object], tmp_path: Path) -> None:
    (tmp_path / "box.xml").write_text(f'<scene version="3.0.0"><shape type="cube">{PEC}</shape></scene>')
    given = {"radar": "airborne_x", "parameters": {"sar_path.max_depth": "1"}, "ground": "soil"}
    loaded = load_scene(tmp_path / "box.xml", **given)
    with pytest.raises(SceneError, match=r"^scene: radar and ground belong to loading"):
        call(loaded, radar="airborne_x", ground="soil")

    class ReachedError(Exception):
        pass

    def ready(run: object) -> None:
        scene = run.scene  # type: ignore[attr-defined]
        assert scene.radar.waveform == loaded.radar.waveform and scene.settings.max_depth == 1
        assert {m.name for m in scene.materials} == {m.name for m in loaded.materials}
        raise ReachedError

    with pytest.raises(ReachedError):
        call(tmp_path / "box.xml", ready=ready, **given)


def test_raw_data_are_focused_from_their_file(tmp_path: Path) -> None:
    raw = sarmitsuba.simulate("point")
    raw.save(tmp_path / "raw.h5")
    again = sarmitsuba.focus(str(tmp_path / "raw.h5"))
    assert (again.data == sarmitsuba.focus(raw).data).all()
    operator = sarmitsuba.focusing_operator(
        tmp_path / "raw.h5", request={"extent_azimuth": 4.0, "extent_range": 4.0}
    )
    assert operator.shape[1] == raw.data.size
    with pytest.raises(
        sarmitsuba.DataError, match=r"^focus: SarImage is no raw data; give those of simulate"
    ):
        sarmitsuba.focus(again)


def test_a_name_loads_the_shipped_scene() -> None:
    assert str(sarmitsuba.link_budget("point")) == str(sarmitsuba.link_budget(load_scene("point")))


@pytest.mark.parametrize(
    ("given", "remedy"),
    [(trimesh.Trimesh, "for mesh in meshes"), (trimesh.Scene, r"for mesh in scene\.dump\(\)")],
)
def test_meshes_of_trimesh_need_a_material(given: type, remedy: str) -> None:
    with pytest.raises(SceneError, match=rf'SceneMesh\.of\(mesh, "concrete"\) {remedy}'):
        build_scene([given()])


@pytest.mark.parametrize(
    ("described", "wrong", "right"),
    [
        (RadarDescription, "look_angle", "look_angle_deg"),
        (FilmDescription, "extent_range", "image_extent_range"),
        (TraceSettings, "depth", "max_depth"),
        (Material, "permitivity", "permittivity"),
    ],
)
def test_unknown_fields_name_the_nearest(described: type, wrong: str, right: str) -> None:
    message = f'^{described.__name__}: unknown parameter "{wrong}"; did you mean "{right}"'
    with pytest.raises(SceneError, match=message):
        described(**{wrong: 1})


def test_lines_of_an_included_file_name_it(tmp_path: Path) -> None:
    (tmp_path / "radar.xml").write_text(
        '<scene version="3.0.0">\n<sensor type="sar_antenna">\n<float name="prf" value="-1"/></sensor></scene>'
    )
    text = '<scene version="3.0.0"><include filename="radar.xml"/><shape type="rectangle"/></scene>'
    (tmp_path / "scene.xml").write_text(text)
    with pytest.raises(RadarError, match=r"^scene\.xml: sensor sar_antenna \(line 2 of radar\.xml\)"):
        load_scene(tmp_path / "scene.xml")


@pytest.mark.parametrize("suffix", [".tif", ".npy", ".h5", ".dat"])
def test_a_binary_file_is_named_what_it_is_not(tmp_path: Path, suffix: str) -> None:
    """An elevation raster holds null characters: the message spoke of UTF-8, not of ``import``."""
    (tmp_path / f"hill{suffix}").write_bytes(b"II*\x00\x08\x00\x00\x00<scene>")
    with pytest.raises(
        SceneError, match=rf"hill{suffix}: it is not a scene; .* import hill{suffix} -o hill.xml"
    ):
        load_scene(tmp_path / f"hill{suffix}")


@pytest.mark.parametrize("name", ["town.blend", "town.usdc", "town.dae"])
def test_a_modellers_file_is_told_of_gltf(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"<COLLADA/>" if name.endswith("dae") else b"BLENDER\x00")
    with pytest.raises(SceneError, match=rf"{name}: models of this format are not read; export it as glTF"):
        load_scene(tmp_path / name)


def test_a_scene_of_any_suffix_is_in_utf_8(tmp_path: Path) -> None:
    (tmp_path / "scene.txt").write_bytes(
        b'<?xml version="1.0" encoding="utf-16"?><scene version="3.0.0"></scene>'
    )
    with pytest.raises(SceneError, match="a scene file is in UTF-8"):
        load_scene(tmp_path / "scene.txt")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (
            '<sensor type="sar_antena"/><shape type="cube"/>',
            r'only sar_antena\); did you mean "sar_antenna"',
        ),
        (
            '<sensor type="sar_antenna"/><shape type="ply"><string name="filename" value="hous.ply"/>'
            + PEC
            + "</shape>",
            r'mesh file "hous.ply" not found .*; did you mean "house.ply"\?',
        ),
        (
            '<include filename="radars/airborne_x.xml"/><shape type="cube"/>',
            r"leave it out .* --radar airborne_x",
        ),
        (
            '<include filename="radars/mine.xml"/><shape type="cube"/>',
            r"no such file beside the scene; check the name",
        ),
    ],
)
def test_near_misses_name_what_was_meant(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "house.ply").write_bytes(b"ply")
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{text}</scene>')
    with pytest.raises(SarmitsubaError, match=match):
        load_scene(tmp_path / "scene.xml")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("look_angle", "did you mean sar_antenna.look_angle_deg"),
        ("image_grid", "give range_film.image_grid"),
        ("wubble", "parameters of plugins are given as plugin.name"),
    ],
)
def test_a_parameter_without_its_plugin_is_shown_with_it(tmp_path: Path, name: str, hint: str) -> None:
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><sensor type="sar_antenna"/><shape type="cube"/></scene>'
    )
    with pytest.raises(SceneError, match=hint):
        load_scene(tmp_path / "scene.xml", parameters={name: "40"})
