"""Parameters by their names, as on the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sarmitsuba.errors import SceneError
from sarmitsuba.gradients.material_parameters import PROPERTIES, Level, LevelMap, MaterialProperty, has_level
from sarmitsuba.gradients.parameter import AXES, Parameter
from sarmitsuba.gradients.radar_parameters import AntennaTrack, ClockOffset, Gain
from sarmitsuba.gradients.shape_parameters import DEFORMATIONS, Deformation, Shift, bodies
from sarmitsuba.materials.map_materials import with_parts

if TYPE_CHECKING:
    from sarmitsuba.scene.scene import Scene


def parse(text: str, scene: Scene) -> tuple[Parameter, ...]:
    """Parameters from a text such as ``gain,level:soil,track:5,shift:roof:z``.

    ``levels`` stands for all materials', and ``heights``, ``scales``, ``rotations``, ``shifts:x`` for those of all
    shapes that are not ground, see :func:`sarmitsuba.gradients.shape_parameters.bodies`.

    Raises
    ------
    SceneError : an unknown kind, or another number of parts than the kind has
    """
    found: list[Parameter] = []
    for word in filter(None, (part.strip() for part in text.split(","))):
        kind, *rest = word.split(":")
        match kind, rest:
            case "gain", []:
                found.append(Gain())
            case "clock_offset", []:
                found.append(ClockOffset())
            case "track", [n] if n.isdecimal() and int(n) > 0:
                found.append(AntennaTrack(int(n)))
            case "track", [n, axes] if n.isdecimal() and int(n) > 0 and axes and set(axes) <= set(AXES):
                found.append(AntennaTrack(int(n), axes))
            case "level", [material]:
                found.append(Level(material))
            case "levels", []:
                names = dict.fromkeys(m.name for m in with_parts(scene.materials) if has_level(m))
                found += [Level(name) for name in names]
            case "level_map", [material]:
                found.append(LevelMap(material))
            case kind, [] if kind.endswith("s") and kind[:-1] in DEFORMATIONS:
                found += [Deformation(kind[:-1], shape) for shape in bodies(scene, word)]
            case "shifts", [axis] if axis in AXES and axis:
                found += [Shift(shape, axis) for shape in bodies(scene, word)]
            case kind, [shape] if kind in DEFORMATIONS:
                found.append(Deformation(kind, shape))
            case kind, [material] if kind in PROPERTIES:
                found.append(MaterialProperty(kind, material))
            case "shift", [shape, axis] if axis in AXES and axis:
                found.append(Shift(shape, axis))
            case _:
                raise SceneError(
                    f"parameter {word!r} is not one of gain, clock_offset, track:KNOTS[:AXES], level:MATERIAL, "
                    f"levels, level_map:MATERIAL, {', '.join(f'{k}:MATERIAL' for k in PROPERTIES)}, "
                    f"shift:SHAPE:AXIS, {', '.join(f'{k}:SHAPE' for k in DEFORMATIONS)}, shifts:AXIS, "
                    f"{', '.join(f'{k}s' for k in DEFORMATIONS)}"
                )
    if not found:
        raise SceneError("parameters: none is given; name at least one, such as gain or levels")
    return tuple(found)
