"""Parameters by their names, as on the command line, and the derivatives of echoes that they need.

Derivatives are traced in parts that one launch carries.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, zip_longest
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.apps.fit.material_parameters import PROPERTIES, Level, LevelMap, MaterialProperty, has_level
from sarmitsuba.apps.fit.parameter import AXES, Parameter, Step, quote_name
from sarmitsuba.apps.fit.radar_parameters import AntennaTrack, BeamPointing, ClockOffset, Gain
from sarmitsuba.apps.fit.shape_parameters import DEFORMATIONS, ComposedMoves, Deformation, Shift, bodies
from sarmitsuba.core.arrays import C64, I64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.scene import Scene
from sarmitsuba.tracing.derivatives.tangents import MOST, Displacement
from sarmitsuba.tracing.kernel.scene_tables import TraceScene

if TYPE_CHECKING:
    from sarmitsuba.scene.scene import Scene


# a part of a parameter's text: a name in quotation marks, in which a doubled one stands for one, or text without any
PART = re.compile(r'\s*(?:"((?:[^"]|"")*)"|([^",:]*))\s*([,:]|$)')


def parse(text: str, scene: Scene) -> tuple[Parameter, ...]:
    """Parameters from a text such as ``gain,level:soil,track:5,shift:roof:z``.

    ``levels`` stands for all materials', ``materials`` for these and every property that a material has, and
    ``heights``, ``scales``, ``rotations``, ``shifts:x`` for those of all shapes that are not ground, see
    :func:`sarmitsuba.apps.fit.shape_parameters.bodies`. Names that hold a comma, a colon or a quotation mark stand in
    quotation marks, ``shift:"block:3, north":z``, and a quotation mark within them is doubled.

    Raises
    ------
    SceneError : an unknown kind, another number of parts than the kind has, or a quotation mark without its other
    """
    found: list[Parameter] = []
    for parts in _words(text):
        kind, *rest = parts
        word = ":".join(quote_name(part) for part in parts)
        own: list[Parameter] | None = None
        for read in (_parse_radar, _parse_materials, _parse_shapes):
            own = read(kind, rest, scene) if own is None else own
        if own is None:
            raise SceneError(
                f"parameter {word!r} is not one of gain, clock_offset, track:KNOTS[:AXES], pointing[:KNOTS], "
                f"level:MATERIAL, levels, materials, level_map:MATERIAL, "
                f"{', '.join(f'{k}:MATERIAL' for k in PROPERTIES)}, shift:SHAPE:AXIS, "
                f"{', '.join(f'{k}:SHAPE' for k in DEFORMATIONS)}, shifts:AXIS, "
                f"{', '.join(f'{k}s' for k in DEFORMATIONS)}"
            )
        found += own
    if not found:
        raise SceneError("parameters: none is given; name at least one, such as gain or levels")
    return tuple(found)


def _words(text: str) -> list[list[str]]:
    """Parts of every word of a text, split at commas and colons outside quotation marks; empty words are left out."""
    words: list[list[str]] = [[]]
    at = 0
    while at <= len(text):
        part = PART.match(text, at)
        if part is None:
            raise SceneError(
                f"parameters {text!r}: a quotation mark stands alone, or within a name; write a name that holds "
                'commas, colons or quotation marks as shift:"block:3":z, with its own quotation marks doubled'
            )
        name, plain, end = part.groups()
        words[-1].append(plain.strip() if name is None else name.replace('""', '"'))
        if end == ",":
            words.append([])
        if not end:
            break
        at = part.end()
    return [word for word in words if word != [""]]


def _parse_radar(kind: str, rest: list[str], scene: Scene) -> list[Parameter] | None:
    match kind, rest:
        case "gain", []:
            return [Gain()]
        case "clock_offset", []:
            return [ClockOffset()]
        case "track", [n] if n.isdecimal() and int(n) > 0:
            return [AntennaTrack(int(n))]
        case "track", [n, axes] if n.isdecimal() and int(n) > 0 and axes and set(axes) <= set(AXES):
            return [AntennaTrack(int(n), axes)]
        case "pointing", []:
            return [BeamPointing()]
        case "pointing", [n] if n.isdecimal() and int(n) > 0:
            return [BeamPointing(int(n))]
    return None


def _parse_materials(kind: str, rest: list[str], scene: Scene) -> list[Parameter] | None:
    names = tuple(dict.fromkeys(m.name for m in list_with_parts(scene.materials)))
    levels: list[Parameter] = [
        Level(name)
        for name in dict.fromkeys(m.name for m in list_with_parts(scene.materials) if has_level(m))
    ]
    match kind, rest:
        case "level", [material]:
            return [Level(material)]
        case "levels", []:
            return levels
        case "materials", []:
            own = (f"{kind}:{quote_name(name)}" for name in names for kind in PROPERTIES)
            return levels + [p for word in own if _has(scene, word) for p in parse(word, scene)]
        case "level_map", [material]:
            return [LevelMap(material)]
        case kind, [material] if kind in PROPERTIES:
            return [MaterialProperty(kind, material)]
    return None


def _parse_shapes(kind: str, rest: list[str], scene: Scene) -> list[Parameter] | None:
    one = kind.removesuffix("s")
    match kind, rest:
        case "shift", [shape, axis] if axis in tuple(AXES):
            return [Shift(shape, axis)]
        case "shifts", [axis] if axis in tuple(AXES):
            return [Shift(shape, axis) for shape in bodies(scene, f"shifts:{axis}")]
        case kind, [shape] if kind in DEFORMATIONS:
            return [Deformation(kind, shape)]
        case kind, [] if kind != one and one in DEFORMATIONS:
            return [Deformation(one, shape) for shape in bodies(scene, kind)]
    return None


def list_parameters(scene: Scene) -> tuple[str, ...]:
    """Parameters of one value that a scene has, as texts: those of its shapes, then those of its materials, then gain.

    Shapes whose names are not unique, ground without end, and properties that a material has not are left out.
    """
    geometry = scene.geometry
    words = []
    for name, endless in zip_longest(geometry.mesh_names, geometry.mesh_endless, fillvalue=False):
        if not endless:
            own = quote_name(str(name))
            words += [f"shift:{own}:{axis}" for axis in AXES] + [f"{kind}:{own}" for kind in DEFORMATIONS]
    for material in dict.fromkeys(m.name for m in list_with_parts(scene.materials)):
        words += [f"{kind}:{quote_name(material)}" for kind in ("level", *PROPERTIES)]
    return (*(word for word in dict.fromkeys(words) if _has(scene, word)), "gain")


def _has(scene: Scene, word: str) -> bool:
    """Whether a scene has the parameter of a text."""
    try:
        found = parse(word, scene)
        found[0].values(scene)
    except SceneError:
        return False
    return True


# properties of materials, and displacements that turn facets, that one launch carries at most: each needs two more sets
# of fields in every ray
MOST_STEPS = 8


@dataclass(frozen=True, eq=False)
class At:
    """The scene at some values of the parameters, and its geometry on the device.

    ``moves`` : of the shapes, at these values; ``displaced`` : whether shapes were displaced with their scatterers, as
    the tables of the geometry say
    """

    scene: Scene
    trace_scene: TraceScene
    moves: ComposedMoves
    displaced: bool = False

    def displacements(self, parameter: Parameter) -> Sequence[Displacement]:
        """Displacements by a parameter at these values."""
        mesh = self.scene.geometry.face_mesh[self.trace_scene.geometry_faces]
        return self.moves.of(parameter, self.scene, mesh)

    def texels(self, places: Sequence[tuple[int, int]]) -> I64:
        """Numbers in the kernel's tables of texels of level maps, given by their materials and numbers there."""
        surfaces = self.trace_scene.surfaces
        if not places:
            return np.zeros(0, dtype=np.int64)
        assert surfaces is not None and surfaces.levels is not None
        own = np.array(places)
        first = {m: surfaces.levels.first_texel(m) for m in set(own[:, 0].tolist())}
        return np.asarray([first[m] for m in own[:, 0].tolist()] + own[:, 1], dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Needed:
    """Derivatives of echoes that parameters need; ``counts``: how many of each of the four sorts, by parameter."""

    displacements: tuple[Displacement, ...]
    levels: tuple[frozenset[int], ...]
    steps: tuple[Step, ...]
    texels: tuple[tuple[int, int], ...] = ()
    pointing: bool = False
    counts: tuple[tuple[int, int, int, int], ...] = ()

    @staticmethod
    def of(parameters: Sequence[Parameter], here: At, *, beam: bool) -> Needed:
        """All that the parameters need, in their order; ``beam``: whether the antenna's pattern counts."""
        scene = here.scene
        moves = [tuple(here.displacements(p)) for p in parameters]
        levels = [tuple(p.levels(scene)) for p in parameters]
        steps = [tuple(p.steps(scene)) for p in parameters]
        texels = [tuple(p.texels(scene)) for p in parameters]
        return Needed(
            tuple(chain.from_iterable(moves)),
            tuple(chain.from_iterable(levels)),
            tuple(chain.from_iterable(steps)),
            tuple(chain.from_iterable(texels)),
            beam and any(p.pointing for p in parameters),
            tuple(
                (len(a), len(b), len(c), len(d))
                for a, b, c, d in zip(moves, levels, steps, texels, strict=True)
            ),
        )

    @property
    def count(self) -> int:
        """Derivatives of each channel."""
        sorts = (self.displacements, self.levels, self.steps, self.texels)
        return sum(len(own) for own in sorts) + 2 * self.pointing

    def parts(self) -> Iterator[Needed]:
        """The same in parts that one launch can carry, dealt evenly, as a grid grows with all that it carries.

        At least one, which may be empty.
        """
        turning = sum(d.turn_rate > 0.0 for d in self.displacements)
        longest = max(len(self.displacements), len(self.levels), len(self.texels))
        n = max(1, -(-longest // MOST), -(-max(turning, len(self.steps)) // MOST_STEPS))
        most = -(-len(self.displacements) // n)
        moves: list[list[Displacement]] = [[]]
        for displacement in self.displacements:
            turns = sum(d.turn_rate > 0.0 for d in (*moves[-1], displacement))
            if len(moves[-1]) == most or turns > MOST_STEPS:
                moves.append([])
            moves[-1].append(displacement)
        n = max(n, len(moves))
        for k in range(n):
            levels, steps, texels = (
                slice(k * len(one) // n, (k + 1) * len(one) // n)
                for one in (self.levels, self.steps, self.texels)
            )
            yield Needed(
                tuple(chain.from_iterable(moves[k : k + 1])),
                self.levels[levels],
                self.steps[steps],
                self.texels[texels],
                self.pointing and k == 0,
            )


@dataclass(frozen=True, eq=False)
class Found:
    """Derivatives found so far, in the order of a :class:`Needed`."""

    displaced: list[C64]
    levelled: list[C64]
    changed: list[C64]
    mapped: list[C64]

    @property
    def sorts(self) -> tuple[list[C64], ...]:
        """All four."""
        return self.displaced, self.levelled, self.changed, self.mapped

    def take(self, counts: Sequence[int]) -> list[list[C64]]:
        """Remove the first of each sort and return them."""
        taken = []
        for own, n in zip(self.sorts, counts, strict=True):
            taken.append(own[:n])
            del own[:n]
        return taken
