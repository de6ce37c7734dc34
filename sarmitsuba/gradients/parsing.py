"""Parameters by their names, as on the command line."""

from __future__ import annotations

from itertools import zip_longest
from typing import TYPE_CHECKING

from sarmitsuba.errors import SceneError
from sarmitsuba.gradients.material_parameters import PROPERTIES, Level, MaterialProperty, has_level
from sarmitsuba.gradients.parameter import AXES, Parameter
from sarmitsuba.gradients.radar_parameters import AntennaTrack, ClockOffset, Gain
from sarmitsuba.gradients.shape_parameters import DEFORMATIONS, Deformation, Shift
from sarmitsuba.materials.map_materials import with_parts

if TYPE_CHECKING:
    from sarmitsuba.scene.scene import Scene


def parse(text: str, scene: Scene) -> tuple[Parameter, ...]:
    """Parameters from a text such as ``gain,level:soil,track:5,shift:roof:z``; ``levels`` stands for all materials'.

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
            case kind, [shape] if kind in DEFORMATIONS:
                found.append(Deformation(kind, shape))
            case kind, [material] if kind in PROPERTIES:
                found.append(MaterialProperty(kind, material))
            case "shift", [shape, axis] if axis in AXES and axis:
                found.append(Shift(shape, axis))
            case _:
                raise SceneError(
                    f"parameter {word!r} is not one of gain, clock_offset, track:KNOTS[:AXES], level:MATERIAL, "
                    f"levels, {', '.join(f'{k}:MATERIAL' for k in PROPERTIES)}, shift:SHAPE:AXIS, "
                    f"{', '.join(f'{k}:SHAPE' for k in DEFORMATIONS)}"
                )
    if not found:
        raise SceneError("parameters: none is given; name at least one, such as gain or levels")
    return tuple(found)


def offered(scene: Scene) -> tuple[str, ...]:
    """Parameters of one value that a scene has, as texts: those of its shapes, then those of its materials, then gain.

    Shapes whose names are not unique, ground without end, and properties that a material has not are left out.
    """
    geometry = scene.geometry
    words = []
    for name, endless in zip_longest(geometry.mesh_names, geometry.mesh_endless, fillvalue=False):
        if not endless:
            words += [f"shift:{name}:{axis}" for axis in AXES] + [f"{kind}:{name}" for kind in DEFORMATIONS]
    for material in dict.fromkeys(m.name for m in with_parts(scene.materials)):
        words += [f"{kind}:{material}" for kind in ("level", *PROPERTIES)]
    return (*(word for word in dict.fromkeys(words) if _has(scene, word)), "gain")


def _has(scene: Scene, word: str) -> bool:
    """Whether a scene has the parameter of a text."""
    try:
        (parameter,) = parse(word, scene)
        parameter.values(scene)
    except SceneError:
        return False
    return True
