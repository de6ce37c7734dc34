"""Parameters by their names, as on the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sarmitsuba.errors import SceneError
from sarmitsuba.gradients.material_parameters import PROPERTIES, Level, MaterialProperty, has_level
from sarmitsuba.gradients.parameter import AXES, Parameter
from sarmitsuba.gradients.radar_parameters import AntennaTrack, BeamPointing, ClockOffset, Gain
from sarmitsuba.gradients.shape_parameters import DEFORMATIONS, Deformation, Shift
from sarmitsuba.materials.map_materials import with_parts

if TYPE_CHECKING:
    from collections.abc import Sequence

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
        radar = _of_radar(kind, rest)
        if radar is not None:
            found.append(radar)
            continue
        match kind, rest:
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
                    f"parameter {word!r} is not one of gain, clock_offset, track:KNOTS[:AXES], pointing[:KNOTS], "
                    f"level:MATERIAL, levels, {', '.join(f'{k}:MATERIAL' for k in PROPERTIES)}, shift:SHAPE:AXIS, "
                    f"{', '.join(f'{k}:SHAPE' for k in DEFORMATIONS)}"
                )
    if not found:
        raise SceneError("parameters: none is given; name at least one, such as gain or levels")
    return tuple(found)


def _of_radar(kind: str, rest: Sequence[str]) -> Parameter | None:
    """Parameter of the radar; None where the words name none."""
    match kind, rest:
        case "gain", []:
            return Gain()
        case "clock_offset", []:
            return ClockOffset()
        case "track", [n] if n.isdecimal() and int(n) > 0:
            return AntennaTrack(int(n))
        case "track", [n, axes] if n.isdecimal() and int(n) > 0 and axes and set(axes) <= set(AXES):
            return AntennaTrack(int(n), axes)
        case "pointing", []:
            return BeamPointing()
        case "pointing", [n] if n.isdecimal() and int(n) > 0:
            return BeamPointing(int(n))
    return None
