"""Mutated scene files: one line of error or a scene, never a traceback, a hang or a crash."""

import faulthandler
import random
import re
import warnings
from collections import Counter
from pathlib import Path

import pytest

from sarmitsuba.core.errors import SarmitsubaError
from sarmitsuba.loading.load import load_scene

HANG = 600.0  # s: a watchdog that says where; one scene takes milliseconds

BASE = (
    """<scene version="3.0.0">
<default name="slant_range" value="10000"/>
<integrator type="sar_path"/>
<sensor type="sar_antenna">
  <float name="slant_range" value="$slant_range"/><float name="bandwidth" value="300e6"/>
  <float name="azimuth_resolution" value="0.5"/><string name="polarisation" value="HH,VV"/>
  <film type="range_film"><float name="image_extent_azimuth" value="16"/></film>
</sensor>
<shape type="sphere" id="target"><point name="center" x="0" y="0" z="0"/><float name="radius" value="0.05"/>
  <bsdf type="point_scatterer"><float name="rcs_dbsm" value="0"/></bsdf></shape>
</scene>""",
    """<scene version="3.0.0">
<integrator type="sar_path"><integer name="max_depth" value="2"/><string name="method" value="raw"/></integrator>
<sensor type="sar_antenna" id="radar"><float name="slant_range" value="1000"/><integer name="n_pulses" value="8"/>
  <film type="range_film"><float name="image_extent_range" value="20"/></film></sensor>
<bsdf type="radar_material" id="m"><string name="material" value="concrete"/>
  <float name="rms_height" value="0.001"/></bsdf>
<bsdf type="twosided" id="t"><bsdf type="diffuse"><rgb name="reflectance" value="0.2 0.3 0.4"/></bsdf></bsdf>
<shape type="cube" id="c"><transform name="to_world"><scale x="2" y="3" z="1"/><rotate z="1" angle="30"/>
  <translate x="1"/><matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform><ref id="m"/></shape>
<shape type="shapegroup" id="g"><shape type="disk"><ref id="t"/></shape></shape>
<shape type="instance"><ref id="g"/><transform name="to_world"><translate z="2"/></transform></shape>
<shape type="cylinder"><float name="radius" value="0.1"/><point name="p0" value="0 0 0"/>
  <point name="p1" value="0,0,1"/><ref id="m"/></shape>
</scene>""",
)
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
        "$zz",
        "true",
        "1" * 30,
        "1 2",
        "1,2,3",
    ),
    *(
        "<",
        "&",
        "&amp;",
        "\x00",
        "é",
        "../x",
        "'",
        '"',
        "--",
        "<!--",
        "-->",
        "]]>",
        "auto",
        "vacuum",
        "1e308",
    ),
    *("0x10", " ", "\t", "\n", "%s", "{}", "\x85", "\x1e", "🛰"),
)
NAMES = ("scene", "sphere", "ply", "obj", "sar_path", "filename", "to_world", "radius", "max_depth")
TAGS = (
    *(
        "float",
        "integer",
        "string",
        "boolean",
        "point",
        "vector",
        "ref",
        "rgb",
        "spectrum",
        "transform",
        "shape",
    ),
    *("bsdf", "sensor", "film", "integrator", "include", "alias", "default", "path", "texture", "emitter"),
    *("medium", "lookat", "animation", "scene"),
)
ELEMENTS = (
    '<include filename="x.xml"/>',
    '<include filename="scene.xml"/>',
    '<ref id="nope"/>',
    '<ref id="c"/>',
    '<alias id="m" as="q"/>',
    '<default name="n" value="3"/>',
    '<string name="a" value="b"/>',
    '<transform name="to_world"><lookat origin="0,0,0" target="0,0,0" up="0,0,1"/></transform>',
    '<shape type="ply"><string name="filename" value="none.ply"/></shape>',
    '<shape type="ply"><string name="filename" value="."/></shape>',
    '<shape type="sphere"><float name="radius" value="-3"/></shape>',
    '<spectrum name="x" value="400:1,500:2"/>',
    '<rgb name="c" value="#ff"/>',
    '<shape type="cube"/>',
    '<path value="."/>',
    '<boolean name="flip_normals" value="maybe"/>',
    '<emitter type="area"><rgb name="radiance" value="1"/></emitter>',
    '<texture type="bitmap"><string name="filename" value="none.png"/></texture>',
    '<bsdf type="mask"/>',
    '<scene version="3.0.0"></scene>',
)


def mutate(rng: random.Random, text: str) -> str:
    """One to six random changes: values, names, tags, elements, lines, characters, cuts and grafts."""
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        kind = rng.choice(
            ("value",) * 4
            + (
                "name",
                "name",
                "element",
                "element",
                "cut",
                "character",
                "line twice",
                "line less",
                "tag",
                "end",
                "token",
                "graft",
            )
        )
        at = rng.randrange(len(text))
        if kind in ("value", "name", "tag"):
            pattern, choices = {
                "value": (r'value="([^"]*)"', TOKENS),
                "name": (r'(?:name|type|id|version|x|y|z|angle)="([^"]*)"', TOKENS + NAMES),
                "tag": (r"</?(\w+)", TAGS),
            }[kind]
            spots = list(re.finditer(pattern, text))
            if spots:
                spot = rng.choice(spots)
                text = text[: spot.start(1)] + rng.choice(choices) + text[spot.end(1) :]
        elif kind == "element":
            starts = [m.start() for m in re.finditer("<", text)] or [0]
            at = rng.choice(starts)
            text = text[:at] + rng.choice(ELEMENTS) + text[at:]
        elif kind == "cut":
            text = text[:at] + text[at + rng.choice((1, 1, 3, 10, 60)) :]
        elif kind == "character":
            text = text[:at] + chr(rng.randrange(1, 256)) + text[at + 1 :]
        elif kind.startswith("line"):
            lines = text.split("\n")
            i = rng.randrange(len(lines))
            if kind == "line twice":
                lines.insert(rng.randrange(len(lines) + 1), lines[i])
            else:
                del lines[i]
            text = "\n".join(lines)
        elif kind == "end":
            text = text[:at]
        elif kind == "token":
            text = text[:at] + rng.choice(TOKENS) + text[at:]
        else:
            other = rng.choice(BASE)
            text = text[:at] + other[rng.randrange(len(other)) :]
        text = text or " "
    return text


@pytest.mark.parametrize("n", [1_000, pytest.param(10_000, marks=pytest.mark.slow)])
def test_mutated_scenes(n: int, row, tmp_path: Path) -> None:
    """Native parser included: a crash ends the process with a traceback of Python's own, a hang after HANG s."""
    path = tmp_path / "scene.xml"
    found: Counter[str] = Counter()
    bad: list[str] = []
    was_on = faulthandler.is_enabled()
    faulthandler.enable()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for i in range(n):
                path.write_bytes(mutate(random.Random(i), BASE[i % 2]).encode("utf-8", "surrogateescape"))
                faulthandler.dump_traceback_later(HANG, exit=True)
                try:
                    load_scene(path)
                    found["loaded"] += 1
                except SarmitsubaError as error:
                    text = str(error)
                    found[type(error).__name__] += 1
                    if len(text.split("\n")) > 1 or not 15 < len(text) < 1000 or ".cpp" in text:
                        bad.append(f"scene {i}: {text!r}")
                except Exception as error:  # what the test looks for
                    found[type(error).__name__] += 1
                    bad.append(f"scene {i}: {error!r}")
    finally:
        faulthandler.cancel_dump_traceback_later()
        if not was_on:
            faulthandler.disable()
    print(f"\n{dict(found)}")
    # the mutations are neither all harmless nor all fatal at the first character
    assert found["loaded"] > 0.03 * n and found["RadarError"] > 0.01 * n
    assert not bad, "\n".join(bad[:10])
    row("10 000 mutated scene files: neither a scene nor one line of error", float(len(bad)), 0.0)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "\x00" * 100,
        "<",
        "<scene/>",
        "<scene>" * 3000,
        "<a>" * 200 + "</a>" * 200,
        '<scene version="3.0.0">' + "<shape type='cube'/>" * 2000 + "</scene>",
        '<scene version="3.0.0"><default name="a" value="$a"/><float name="x" value="$a"/></scene>',
        '<?xml version="1.0"?><!DOCTYPE s [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><scene>&b;</scene>',
        '<scene version="3.0.0"><include filename="scene.xml"/></scene>',
        '<scene version="99999999999999999999.0.0"/>',
        '<scene version="3.0.0"><bsdf type="twosided" id="a"><ref id="a"/></bsdf></scene>',
        '<scene version="3.0.0"><shape type="shapegroup" id="g"><shape type="instance"><ref id="g"/></shape></shape>'
        '<shape type="instance"><ref id="g"/></shape></scene>',
    ],
    ids=[
        *(
            "empty",
            "zeros",
            "one character",
            "no version",
            "never closed",
            "not a scene",
            "no sensor",
            "own default",
        ),
        *("entities", "includes itself", "version", "refers to itself", "group in itself"),
    ],
)
def test_pathological_files(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(text, encoding="utf-8")
    faulthandler.dump_traceback_later(HANG, exit=True)
    try:
        with warnings.catch_warnings(), pytest.raises(SarmitsubaError) as caught:
            warnings.simplefilter("ignore")
            load_scene(path)
    finally:
        faulthandler.cancel_dump_traceback_later()
    message = str(caught.value)
    assert "\n" not in message and "Traceback" not in message and len(message) > 15
