"""Derivatives of echoes that parameters need, in parts that one launch carries, and those found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from sarmitsuba.apps.fit.composed_moves import ComposedMoves
from sarmitsuba.apps.fit.parameter import Parameter, Step
from sarmitsuba.core.arrays import C64, I64
from sarmitsuba.scene.scene import Scene
from sarmitsuba.tracing.derivatives.tangents import MOST, Displacement
from sarmitsuba.tracing.kernel.scene_tables import TraceScene

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
