"""Training, validation and test parts, disjoint by instance or by scene."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sarmitsuba.apps.datasets.drawn_shapes import InstanceMesh
from sarmitsuba.apps.datasets.recipe import PART_NAMES, Recipe
from sarmitsuba.core.errors import DataError

# first words of seeds, so that no two kinds of draws share random numbers
SCENE_DRAW, VIEW_DRAW, PART_DRAW, MESH_DRAW = range(4)


@dataclass(frozen=True, eq=False)
class DatasetParts:
    """Part of every scene, and of every mesh.

    Parameters
    ----------
    recipe : with the shares
    meshes : all instances; empty in recipes without
    """

    recipe: Recipe
    meshes: Sequence[InstanceMesh]

    def of_scene(self, scene: int) -> str:
        """Part of a scene, by number."""
        generator = np.random.default_rng(np.random.SeedSequence((self.recipe.seed, PART_DRAW, scene)))
        shares = np.cumsum([self.recipe.real("parts", name) for name in PART_NAMES])
        index = int(np.searchsorted(shares / shares[-1], generator.uniform(), side="right"))
        return PART_NAMES[min(index, len(PART_NAMES) - 1)]

    @cached_property
    def of_meshes(self) -> dict[str, str]:
        """Part of every mesh by name, the shares held within each class; empty where parts are by scene.

        Raises
        ------
        DataError
            A class has too few meshes for the parts.
        """
        if self.recipe.text("parts", "by") != "instance":
            return {}
        generator = np.random.default_rng(np.random.SeedSequence((self.recipe.seed, MESH_DRAW)))
        wanted = [name for name in PART_NAMES if self.recipe.real("parts", name) > 0.0]
        out: dict[str, str] = {}
        for kind in sorted({mesh.semantic_class for mesh in self.meshes}):
            names = [mesh.name for mesh in self.meshes if mesh.semantic_class == kind]
            if len(names) < len(wanted):
                raise DataError(
                    f"{self.recipe.path.name}: [parts]: class {kind} has {len(names)} meshes for {len(wanted)} parts "
                    'by instance; add meshes, or give by = "scene"'
                )
            order = [names[i] for i in generator.permutation(len(names))]
            for name, count in zip(wanted, self._counts(len(names), wanted), strict=True):
                out |= dict.fromkeys(order[:count], name)
                order = order[count:]
        return out

    def _counts(self, total: int, wanted: Sequence[str]) -> list[int]:
        """Meshes of a class in each part: at least one, the rest by the largest remainder."""
        share = np.array([self.recipe.real("parts", name) for name in wanted])
        exact = share / share.sum() * total
        counts = np.maximum(np.floor(exact).astype(int), 1)
        while counts.sum() > total:
            counts[int(np.argmax(np.where(counts > 1, counts - exact, -np.inf)))] -= 1
        while counts.sum() < total:
            counts[int(np.argmax(exact - counts))] += 1
        return [int(count) for count in counts]

    def meshes_of(self, part: str) -> tuple[InstanceMesh, ...]:
        """Meshes that scenes of a part may hold."""
        of = self.of_meshes
        return tuple(mesh for mesh in self.meshes if not of or of[mesh.name] == part)
