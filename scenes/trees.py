"""Trees of the shipped scenes: where they stand, as instances of a few, and the command that writes the scene files.

``python scenes/trees.py`` writes ``forest.xml``, ``street_trees.xml`` and ``urban_block_trees.xml`` beside itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Kind:
    """A tree at the origin, 1 wide and high as its own; instances stretch it.

    Parameters
    ----------
    name : of its shape group
    preset : of its crown
    crown : half width and half height, m
    center : height of the crown's middle, m
    trunk : radius and height, m
    round_trunk : else it is square: in scenes without other curved surfaces mirrors stay plane
    """

    name: str
    preset: str
    crown: tuple[float, float]
    center: float
    trunk: tuple[float, float]
    round_trunk: bool = True


LIME = Kind("lime", "deciduous_summer", (2.8, 3.6), 7.0, (0.16, 4.0))
SPRUCE = Kind("spruce", "conifer", (1.9, 5.5), 8.0, (0.15, 4.0))
STREET = Kind("street_tree", "deciduous_summer", (2.2, 2.6), 5.4, (0.11, 3.2))
PARK = Kind("park_tree", "deciduous_summer", (2.1, 2.6), 5.0, (0.18, 3.6), round_trunk=False)


def grove(
    kind: Kind, low: Sequence[float], high: Sequence[float], distance: float, seed: int
) -> list[tuple[Kind, float, float, float]]:
    """Trees (kind, x, y, size) drawn in a rectangle, no two closer than ``distance``, m."""
    rng = np.random.default_rng(seed)
    found: list[tuple[float, float]] = []
    for _ in range(4000):
        x, y = rng.uniform(low, high)
        if all(np.hypot(x - a, y - b) >= distance for a, b in found):
            found.append((x, y))
    return [(kind, x, y, rng.uniform(0.8, 1.15)) for x, y in found]


def groups(kinds: Sequence[Kind]) -> str:
    """Materials and one shape group for each kind."""
    text = ""
    for preset in dict.fromkeys(kind.preset for kind in kinds):
        text += f'''
    <bsdf type="radar_volume" id="{preset}">
        <string name="preset" value="{preset}"/>
    </bsdf>
'''
    text += """
    <bsdf type="radar_material" id="bark">
        <string name="material" value="fresh_wood"/>
        <float name="rms_height" value="0.002"/>
        <string name="diffuse_law" value="lambert"/>
        <float name="diffuse_level_db" value="-15"/>
    </bsdf>
"""
    for kind in kinds:
        text += f'''
    <shape type="shapegroup" id="{kind.name}">
        {_trunk(kind)}
        <shape type="sphere" id="{kind.name}_crown">
            <transform name="to_world">
                <scale x="{kind.crown[0]:g}" y="{kind.crown[0]:g}" z="{kind.crown[1]:g}"/>
                <translate z="{kind.center:g}"/>
            </transform>
            <ref id="{kind.preset}"/>
        </shape>
    </shape>
'''
    return text


def _trunk(kind: Kind) -> str:
    radius, height = kind.trunk
    if kind.round_trunk:
        return f'''<shape type="cylinder" id="{kind.name}_trunk">
            <float name="radius" value="{radius:g}"/>
            <point name="p0" x="0" y="0" z="-0.2"/>
            <point name="p1" x="0" y="0" z="{height:g}"/>
            <ref id="bark"/>
        </shape>'''
    return f'''<shape type="cube" id="{kind.name}_trunk">
            <transform name="to_world">
                <translate z="1"/>
                <scale x="{radius:g}" y="{radius:g}" z="{0.5 * height:g}"/>
                <rotate z="1" angle="27"/>
            </transform>
            <ref id="bark"/>
        </shape>'''


def instances(trees: Sequence[tuple[Kind, float, float, float]]) -> str:
    """One instance for each tree."""
    text = ""
    for kind, x, y, size in trees:
        text += f'''
    <shape type="instance">
        <transform name="to_world">
            <scale value="{size:.3f}"/>
            <translate x="{x:.2f}" y="{y:.2f}"/>
        </transform>
        <ref id="{kind.name}"/>
    </shape>'''
    return text + "\n"


def sensor(extent: tuple[float, float], spacing: float, heading: float = 0.0) -> str:
    """Radar and image; what bands change is set by name."""
    return f'''    <default name="center_frequency" value="1.27e9"/>
    <default name="look_angle_deg" value="40"/>
    <default name="heading_deg" value="{heading:g}"/>
    <default name="polarisation" value="HH,VV,HV"/>

    <integrator type="sar_path"/>

    <sensor type="sar_antenna">
        <string name="mode" value="spotlight"/>
        <float name="slant_range" value="8000"/>
        <float name="heading_deg" value="$heading_deg"/>
        <float name="look_angle_deg" value="$look_angle_deg"/>
        <float name="center_frequency" value="$center_frequency"/>
        <float name="bandwidth" value="{150e6 / spacing:.4g}"/>
        <float name="azimuth_resolution" value="{spacing:g}"/>
        <string name="polarisation" value="$polarisation"/>
        <float name="aim_x" value="0"/>
        <float name="aim_y" value="0"/>
        <float name="aim_z" value="0"/>
        <film type="range_film">
            <string name="image_grid" value="ground"/>
            <float name="image_extent_azimuth" value="{extent[0]:g}"/>
            <float name="image_extent_range" value="{extent[1]:g}"/>
        </film>
    </sensor>
'''


SOIL = """
    <bsdf type="radar_material" id="soil">
        <string name="material" value="medium_dry_ground"/>
        <float name="rms_height" value="0.0025"/>
        <float name="correlation_length" value="0.1"/>
        <string name="diffuse_law" value="iem"/>
    </bsdf>
"""


def rectangle(name: str, half: tuple[float, float], center: tuple[float, float, float], material: str) -> str:
    """A level rectangle."""
    return f'''
    <shape type="rectangle" id="{name}">
        <transform name="to_world">
            <scale x="{half[0]:g}" y="{half[1]:g}" z="1"/>
            <translate x="{center[0]:g}" y="{center[1]:g}" z="{center[2]:g}"/>
        </transform>
        <ref id="{material}"/>
    </shape>
'''


def forest() -> str:
    """A stand of spruces and limes with a ride between."""
    trees = grove(SPRUCE, (-12, -17), (12, -3), 5.0, 1) + grove(LIME, (-12, 4), (12, 17), 6.2, 2)
    head = f"""<!--
Forest stand of spruces and limes
{len(trees)} trees on soil, spruces in the south and limes in leaf in the north, a ride between, 44 m x 40 m. L band,
or another by -D center_frequency=5.4e9 or 9.65e9; cells of 0.6 m, 8 km, looking east at 40 deg. To look for: at L
band a bright dot for every trunk, from ground and trunk together, seen through the crowns; at X band the crowns
themselves, laid over to the west, with shadows behind them.
-->
<scene version="3.0.0">
"""
    return (
        head
        + sensor((44, 40), 0.6)
        + SOIL
        + rectangle("ground", (30, 30), (0, 0, 0), "soil")
        + groups((SPRUCE, LIME))
        + instances(trees)
        + "</scene>\n"
    )


MATERIALS = """
    <bsdf type="radar_material" id="asphalt">
        <string name="material" value="asphalt_concrete"/>
        <float name="rms_height" value="0.003"/>
        <string name="diffuse_law" value="constant_gamma"/>
        <float name="diffuse_level_db" value="-22"/>
    </bsdf>

    <bsdf type="radar_material" id="brick">
        <string name="material" value="brick"/>
        <float name="rms_height" value="0.005"/>
        <string name="diffuse_law" value="lambert"/>
        <float name="diffuse_level_db" value="-10"/>
    </bsdf>

    <bsdf type="radar_material" id="bodywork">
        <string name="material" value="metal"/>
        <float name="rms_height" value="0.003"/>
        <string name="diffuse_law" value="constant_gamma"/>
        <float name="diffuse_level_db" value="3"/>
    </bsdf>

    <bsdf type="radar_volume" id="hedge">
        <string name="preset" value="hedge"/>
    </bsdf>
"""


def cube(
    name: str, half: tuple[float, float, float], center: tuple[float, float, float], material: str
) -> str:
    """A box along the axes."""
    return (
        rectangle(name, half[:2], center, material)
        .replace("rectangle", "cube")
        .replace('z="1"/>', f'z="{half[2]:g}"/>')
    )


def street_trees() -> str:
    """A street between two rows of houses, with trees on both sides, a hedge and parked cars."""
    trees = [
        (STREET, x, y, 1.0 + 0.1 * ((i * 7) % 3 - 1))
        for x in (-6.5, 6.5)
        for i, y in enumerate((-19, -10, 1, 10, 19))
    ]
    head = """<!--
Street with trees and a hedge
Two houses along a street of 20 m, ten trees in leaf beside the kerbs, a hedge and parked cars, 48 m x 48 m. X band,
or another by -D center_frequency=1.27e9 or 5.4e9; cells of 0.6 m, 8 km, look angle 40 deg, 14 deg off the street. To
look for: crowns laid over to the west with their shadows on asphalt and houses; the facade behind them dimmed at X
band, at L band hardly; the hedge as an even line.
-->
<scene version="3.0.0">
"""
    parts = [
        rectangle("ground", (36, 36), (0, 0, 0), "asphalt"),
        cube("house_west", (6, 24, 5), (-16, 0, 5), "brick"),
        cube("house_east", (6, 24, 6), (16, 0, 6), "brick"),
        cube("hedge_east", (0.5, 12, 0.8), (8.8, 6, 0.8), "hedge"),
    ]
    parts += [
        cube(f"car_{i}", (0.9, 2.2, 0.6), (x, y, 0.75), "bodywork")
        for i, (x, y) in enumerate(((-4.2, -14.0), (-4.2, 5.5), (4.2, -5.0), (4.2, 14.5)))
    ]
    return (
        head
        + sensor((48, 48), 0.6, heading=14.0).replace("1.27e9", "9.65e9")
        + MATERIALS
        + "".join(parts)
        + groups((STREET,))
        + instances(trees)
        + "</scene>\n"
    )


def urban_block_trees() -> str:
    """The urban block with crowns that waves go through in place of its opaque ones."""
    block = (HERE / "urban_block.xml").read_text(encoding="utf-8")
    body = block[block.index("-->") :]
    for start, end in (
        ('    <bsdf type="radar_material" id="leaves">', "</bsdf>\n"),
        ('    <shape type="ply" id="trees">', "</shape>\n"),
    ):
        first = body.index(start)
        body = body[:first] + body[body.index(end, first) + len(end) :]
    # where urban_block.py plants them, but for the draw
    places = [(-23, -44), (-15, -41), (-7, -45), (-21, -33), (-11, -32), (-3, -37), (-19, -23), (-8, -22)]
    places += [(-62, y) for y in (-44, -31, -19, -8, 15, 26, 38, 51)]
    places += [(-12, y) for y in (20, 29, 38)]
    sizes = np.random.default_rng(7).uniform(0.85, 1.2, len(places))
    trees = [(PARK, x, y, size) for (x, y), size in zip(places, sizes, strict=True)]
    head = """<!--
Urban block with trees
The urban block with trees that waves go through: broad-leaved crowns in leaf on square trunks, in the courtyard, on the
square and in the park beside the avenue. To look for: facades, grass and paving seen through the crowns, 10 dB
darker, and crowns without the hard shadow of opaque ones.
"""
    return head + body.replace("</scene>", groups((PARK,)) + instances(trees) + "</scene>")


if __name__ == "__main__":
    for write in (forest, street_trees, urban_block_trees):
        (HERE / f"{write.__name__}.xml").write_text(write(), encoding="utf-8")
