"""A crane of thin steel cylinders as a scene file: what wants the most rays for the least surface."""

from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64


def bar(a: F64, b: F64, radius: float) -> str:
    """A steel cylinder between two points, m."""
    ends = "".join(
        f'<point name="{name}" x="{p[0]}" y="{p[1]}" z="{p[2]}"/>' for name, p in (("p0", a), ("p1", b))
    )
    return f'<shape type="cylinder">{ends}<float name="radius" value="{radius}"/><ref id="steel"/></shape>'


def crane(folder: Path) -> Path:
    """A crane of 88 members of 4 and 8 cm, 30 m high, on asphalt; without a radar. Return its scene file."""
    corner = np.array([[-0.8, -0.8, 0.0], [0.8, -0.8, 0.0], [0.8, 0.8, 0.0], [-0.8, 0.8, 0.0]])
    up = np.array([0.0, 0.0, 1.5])
    shapes = [bar(c, c + 20 * up, 0.04) for c in corner]
    for i in range(20):
        for k in range(4):
            a, b = (k, (k + 1) % 4) if i % 2 == 0 else ((k + 1) % 4, k)
            shapes.append(bar(corner[a] + i * up, corner[b] + (i + 1) * up, 0.02))
    shapes += [bar(corner[k] + 20 * up, corner[(k + 1) % 4] + 20 * up, 0.02) for k in range(4)]
    materials = "".join(
        f'<bsdf type="radar_material" id="{name}"><string name="material" value="{of}"/>'
        '<float name="rms_height" value="0.001"/><string name="diffuse_law" value="none"/></bsdf>'
        for name, of in (("asphalt", "asphalt_concrete"), ("steel", "metal"))
    )
    plate = '<shape type="rectangle"><transform name="to_world"><scale value="30"/></transform>'
    plate += '<ref id="asphalt"/></shape>'
    path = folder / "crane.xml"
    path.write_text(f'<scene version="3.0.0">{materials}{plate}{"".join(shapes)}</scene>', encoding="utf-8")
    return path
