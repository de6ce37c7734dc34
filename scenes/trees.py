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
    """

    name: str
    preset: str
    crown: tuple[float, float]
    center: float
    trunk: tuple[float, float]


LIME = Kind("lime", "deciduous_summer", (2.8, 3.6), 7.4, (0.16, 5.5))
SPRUCE = Kind("spruce", "conifer", (1.9, 6.0), 8.5, (0.15, 7.0))
STREET = Kind("street_tree", "deciduous_summer", (2.2, 2.8), 5.6, (0.11, 4.0))


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
        radius, height = kind.trunk
        text += f'''
    <shape type="shapegroup" id="{kind.name}">
        <shape type="cylinder" id="{kind.name}_trunk">
            <float name="radius" value="{radius:g}"/>
            <point name="p0" x="0" y="0" z="-0.2"/>
            <point name="p1" x="0" y="0" z="{height:g}"/>
            <ref id="bark"/>
        </shape>
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


def sensor(extent: tuple[float, float], spacing: float) -> str:
    """Radar and image; what bands change is set by name."""
    return f'''    <default name="center_frequency" value="1.27e9"/>
    <default name="look_angle_deg" value="40"/>
    <default name="heading_deg" value="0"/>
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
        <float name="rms_height" value="0.008"/>
        <float name="correlation_length" value="0.08"/>
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
    trees = grove(SPRUCE, (-22, -24), (22, -4), 3.4, 1) + grove(LIME, (-22, 4), (22, 24), 5.0, 2)
    head = f"""<!--
Forest stand
{len(trees)} trees on soil, spruces in the south and limes in leaf in the north, a ride between them; 60 m x 64 m. L band by
default, cells of 1 m, 8 km, looking east at 40 deg; -D center_frequency=5.4e9 and 9.65e9 for C and X band. To look
for: at L band a bright dot for every trunk, from ground and trunk together, through the crowns; at X band crowns alone,
laid over to the west, and their shadows.
-->
<scene version="3.0.0">
"""
    return (
        head
        + sensor((64, 60), 1.0)
        + SOIL
        + rectangle("ground", (45, 45), (0, 0, 0), "soil")
        + groups((SPRUCE, LIME))
        + instances(trees)
        + "</scene>\n"
    )


if __name__ == "__main__":
    (HERE / "forest.xml").write_text(forest(), encoding="utf-8")
