"""Draw of a sample of a data set: scene and radar, from the recipe's seed and the sample's number alone.

Shapes are placed so that nothing touches, in scene files whose content is examined here. Samples belong to training,
validation or test, disjoint by instance or by scene.
"""

import hashlib
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sarmitsuba.analysis.label_classes import check_used, shape_names
from sarmitsuba.analysis.label_owners import material_names, no_surface_materials
from sarmitsuba.apps.dataset_recipe import CLASSES, PART_NAMES, Recipe, RecipeSection, read_recipe
from sarmitsuba.apps.dataset_shapes import (
    InstanceMesh,
    box,
    crown,
    hull,
    lowest_under,
    mesh_folder,
    read_instances,
    relief,
    separation,
    turn_points,
)
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError, SarmitsubaError, SarmitsubaWarning, SceneError
from sarmitsuba.core.parameters import Value, float_value, string_value
from sarmitsuba.loading.build import SceneMesh, SceneVolume, build_scene
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.regular_files import read_bytes
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.mode import mode_parameters
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.execution.fingerprint import fingerprint

# trials of a place before a draw is given up
_TRIALS = 200


@dataclass
class ShapeLayout:
    """Plan of the shapes placed so far.

    Parameters
    ----------
    outlines : convex hulls (n, 2), m, in plan
    """

    outlines: list[F64] = field(default_factory=list)

    def place(
        self,
        name: str,
        vertices: F64,
        heading: float,
        spread: float,
        gap: float,
        generator: np.random.Generator,
    ) -> F64:
        """Vertices (n, 3) at a drawn place, at least ``gap`` from all others in plan.

        Parameters
        ----------
        name : of the shape, for the error
        vertices : (n, 3) m, about the origin
        heading : rad, from x to y
        spread : side of the square of places about the origin, m
        gap : m
        generator : of the places

        Raises
        ------
        SceneError
            No free place was found.
        """
        shape = turn_points(vertices, heading)
        outline = hull(shape[:, :2])
        for _ in range(_TRIALS):
            shift = generator.uniform(-0.5, 0.5, 2) * spread
            if all(separation(outline + shift, other) >= gap for other in self.outlines):
                self.outlines.append(outline + shift)
                shape[:, :2] += shift
                return shape
        raise SceneError(
            f"{name}: no free place among {len(self.outlines)} shapes within {spread:g} m in {_TRIALS} trials; draw "
            "fewer shapes or a larger spread"
        )


@dataclass(frozen=True)
class SceneFile:
    """Names in a scene file.

    Parameters
    ----------
    digest : hash of all that belongs to the scene; "" where it cannot be read: its draws fail, and say why
    shapes, materials : names
    """

    digest: str
    shapes: tuple[str, ...] = ()
    materials: tuple[str, ...] = ()

    @staticmethod
    def of(file: Path | str) -> "SceneFile":
        """Names in a file, or in a shipped scene."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SarmitsubaWarning)
            try:
                scene = load_scene(file)
            except SarmitsubaError:
                return SceneFile("")
        return SceneFile(fingerprint(scene), shape_names(scene), tuple(material_names(scene.materials)))


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


Values = Mapping[str, Value | None]
# margin by which the feet of walls and boxes are sunk into ground with relief, m
_SUNK = 0.05
# most bytes of a file that the radar names
_MOST_BYTES = 1_000_000_000


@dataclass(frozen=True, eq=False)
class PlacedShape:
    """One shape of a drawn scene.

    Parameters
    ----------
    name : of its mesh in the scene
    semantic_class : of the shape
    instance : name of its mesh in the folder; "" for walls, boxes and trees
    vertices : (n, 3) float64, m
    heading : of its x axis from east to north, rad
    scale : factor of its lengths
    """

    name: str
    semantic_class: str
    instance: str
    vertices: F64
    heading: float
    scale: float


@dataclass
class DrawnShapes:
    """Shapes of a scene, in the making.

    Parameters
    ----------
    meshes, volumes : of the scene
    shapes : placed ones with their classes
    ground : material of level ground at z = 0
    facts : drawn values by ``section.parameter``
    """

    meshes: list[SceneMesh] = field(default_factory=list)
    volumes: list[SceneVolume] = field(default_factory=list)
    shapes: list[PlacedShape] = field(default_factory=list)
    ground: Mapping[str, Value] | None = None
    facts: dict[str, Value | None] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class DrawnSample:
    """Scene of a sample, and the drawn values.

    Parameters
    ----------
    number, part : of the sample
    scene : to render
    shapes : placed ones
    facts : drawn values by ``section.parameter``
    focusing : values of [focusing]
    """

    number: int
    part: str
    scene: Scene
    shapes: tuple[PlacedShape, ...]
    facts: Mapping[str, Value | None]
    focusing: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Drawer:
    """Draws of a recipe, with its meshes read once."""

    recipe: Recipe

    @staticmethod
    def of(path: str) -> "Drawer":
        """Drawer of a recipe file."""
        return Drawer(read_recipe(path))

    @cached_property
    def meshes(self) -> tuple[InstanceMesh, ...]:
        """All instances; empty where the recipe places none."""
        recipe = self.recipe
        if recipe.from_file or "objects" not in recipe.given:
            return ()
        section = recipe.sections["objects"]
        folder = mesh_folder(section.text("meshes"), recipe.path.parent)
        return read_instances(folder, section.text("classes"))

    @property
    def files(self) -> tuple[str, ...]:
        """All that the recipe may draw as scene files or files of the radar, as it names them."""
        wanted = {
            f"{section.name}.{name}": kind.texts
            for section in self.recipe.sections.values()
            for name, kind in section.drawn.items()
        }
        return tuple(
            sorted(
                {
                    text
                    for name, texts in wanted.items()
                    for text in texts
                    if text and (name == "scene.file" or name.endswith("_file"))
                }
            )
        )

    @cached_property
    def scene_files(self) -> dict[str, SceneFile]:
        """Content of the recipe's scene files, by name."""
        if not self.recipe.from_file:
            return {}
        return {name: SceneFile.of(self._file(name)) for name in self.recipe.drawn("scene", "file").texts}

    def _file(self, name: str) -> Path | str:
        """A scene file beside the recipe, or the name of a shipped scene."""
        own = self.recipe.file_beside(name)
        return own if os.path.isfile(own) else name

    def file_hash(self, name: str) -> str:
        """Hash of a file of :attr:`files`; of a scene that of all that belongs to it. "" where it cannot be read."""
        path = self.recipe.file_beside(name)
        if name in self.scene_files:
            return self.scene_files[name].digest
        return hashlib.sha256(read_bytes(path, _MOST_BYTES)).hexdigest() if os.path.isfile(path) else ""

    @cached_property
    def parts(self) -> DatasetParts:
        """Parts of scenes and meshes."""
        return DatasetParts(self.recipe, self.meshes)

    @property
    def classes(self) -> tuple[str, ...]:
        """Semantic classes of the recipe's shapes, in the order of their codes."""
        kinds = {mesh.semantic_class for mesh in self.meshes} | set(self.recipe.class_table.values())
        kinds |= {kind for name, kind in _KINDS.items() if name in self.recipe.given}
        return tuple(sorted(kinds))

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of all materials that echoes may come from, in the order of their codes."""
        if self.recipe.from_file:
            found = {name for file in self.scene_files.values() for name in file.materials}
        else:
            sections = (self.recipe.sections[name] for name in (GROUND, *PLACED))
            found = {text for s in sections if "material" in s.drawn for text in s.drawn["material"].texts}
        no_surface = no_surface_materials()
        return (*sorted(found - set(no_surface)), *no_surface)

    def check_classes(self) -> None:
        """Raise a DataError where [classes] names a shape that no scene of the recipe has."""
        if self.recipe.from_file:
            names = {name for file in self.scene_files.values() for name in file.shapes}
            if not names:
                return  # no file can be read: the draws fail, and say why
        else:
            names = {GROUND}
        check_used(
            self.recipe.class_table, sorted(names), f"{self.recipe.path.name}: [{CLASSES}]: the scenes have"
        )

    def draw(self, number: int, attempt: int) -> DrawnSample:
        """Sample of a number; other attempts draw its radar, and their scene, anew.

        Raises
        ------
        SarmitsubaError
            The draw is no possible scene or radar.
        """
        recipe = self.recipe
        scene_number = number // recipe.views
        levels = recipe.levels(number)
        generator = np.random.default_rng(np.random.SeedSequence((recipe.seed, VIEW_DRAW, number, attempt)))
        values = {name: recipe.sections[name].draw(generator, levels) for name in _VIEW}
        seed = int(generator.integers(2**31))
        facts = {f"{name}.{key}": value for name in _VIEW for key, value in values[name].items()}
        for key, value in values["radar"].items():
            if key.endswith("_file") and value:  # relative to the recipe
                values["radar"][key] = str(recipe.file_beside(str(value)).resolve())
        part = self.parts.of_scene(scene_number)
        # views of one scene share its first possible draw
        if recipe.from_file:
            scene = self._loaded(
                values, scene_number, attempt if recipe.views == 1 else 0, levels, seed, facts
            )
            shapes: tuple[PlacedShape, ...] = ()
        else:
            shown = self._shapes(scene_number, part, levels, attempt if recipe.views == 1 else 0)
            scene = self._build_scene(shown, values, seed, recipe.path.stem)
            shapes, facts = tuple(shown.shapes), facts | shown.facts
        focusing = {key: string_value(values["focusing"], key) for key in values["focusing"]}
        return DrawnSample(number, part, scene, shapes, facts, focusing)

    def _shapes(self, scene: int, part: str, levels: Mapping[str, int], attempt: int) -> DrawnShapes:
        """Shapes of a scene; views of one scene take the first draw in which all find a place."""
        last = attempt if self.recipe.views == 1 else self.recipe.whole("dataset", "attempts") - 1
        for i in range(attempt, last + 1):
            try:
                return self._drawn_shapes(scene, part, levels, i)
            except SarmitsubaError:
                if i == last:
                    raise
        raise AssertionError

    def _drawn_shapes(self, scene: int, part: str, levels: Mapping[str, int], attempt: int) -> DrawnShapes:
        recipe, out, layout = self.recipe, DrawnShapes(), ShapeLayout()
        generator = np.random.default_rng(np.random.SeedSequence((recipe.seed, SCENE_DRAW, scene, attempt)))
        ground = self._ground(out, generator, levels)
        for name in PLACED:
            if name not in recipe.given:
                continue
            section = recipe.sections[name]
            count = section.draw(generator, levels)["count"]
            assert isinstance(count, int)
            out.facts[f"{name}.count"] = count
            for i in range(count):
                self._place(out, layout, ground, (section, i, part), generator, levels)
        return out

    def _ground(
        self, out: DrawnShapes, generator: np.random.Generator, levels: Mapping[str, int]
    ) -> F64 | None:
        """Add ground; its points where it has relief."""
        values = self.recipe.sections[GROUND].draw(generator, levels)
        out.facts |= {f"{GROUND}.{name}": value for name, value in values.items()}
        if values["material"] == "none":
            return None
        material = _material(values)
        if not values["relief"]:
            out.ground = material
            return None
        extent, rms, length = (float_value(values, name) for name in ("extent", "relief", "relief_length"))
        vertices, faces = relief(extent, rms, length, generator)
        out.meshes.append(SceneMesh(vertices, faces, material, GROUND))
        return vertices

    def _place(
        self,
        out: DrawnShapes,
        layout: ShapeLayout,
        ground: F64 | None,
        which: tuple[RecipeSection, int, str],
        generator: np.random.Generator,
        levels: Mapping[str, int],
    ) -> None:
        """Add one shape of a section."""
        section, index, part = which
        values = section.draw(generator, levels)
        name = f"{section.name}_{index + 1}"
        kind, instance, scale = _KINDS.get(section.name, ""), "", 1.0
        if section.name == "objects":
            meshes = self.parts.meshes_of(part)
            mesh = meshes[int(generator.integers(len(meshes)))]
            scale = float_value(values, "scale")
            kind, instance = mesh.semantic_class, mesh.name
            vertices, faces = scale * mesh.vertices, mesh.faces
        elif section.name == "walls":
            vertices, faces = box([float_value(values, key) for key in ("length", "thickness", "height")])
        elif section.name == "clutter":
            spread = float_value(values, "irregularity") * generator.standard_normal(3).clip(-1.5, 1.5)
            vertices, faces = box([float(v) for v in float_value(values, "size") * (1.0 + spread)])
        else:
            vertices, faces = crown(float_value(values, "radius"), float_value(values, "height"), generator)
        heading = float(np.deg2rad(float_value(values, "heading_deg")))
        room = float_value(values, "spread"), float_value(values, "gap")
        placed = layout.place(name, vertices, heading, *room, generator)
        if ground is not None:
            placed[:, 2] += lowest_under(ground, placed[:, :2]) - (_SUNK if not instance else 0.0)
        out.shapes.append(PlacedShape(name, kind, instance, placed, heading, scale))
        if section.name == "trees":
            out.volumes.append(SceneVolume(placed, faces, string_value(values, "preset"), name))
        else:
            out.meshes.append(SceneMesh(placed, faces, _material(values), name))

    def _film(self, values: Mapping[str, Values]) -> dict[str, Any]:
        rows, columns = self.recipe.shape
        middle = {"image_center_x": 0.0, "image_center_y": 0.0, "image_height": 0.0}
        given = {name: value for name, value in values["film"].items() if value is not None}
        return (
            (middle if not self.recipe.from_file else {})
            | given
            | {
                "pixels_azimuth": rows,
                "pixels_range": columns,
            }
        )

    def _build_scene(self, shown: DrawnShapes, values: Mapping[str, Values], seed: int, name: str) -> Scene:
        """Scene of drawn shapes under a drawn radar."""
        of_modes = {p.name for p in mode_parameters()}
        radar: dict[str, Any] = {"aim_x": 0.0, "aim_y": 0.0, "aim_z": 0.0}
        radar |= {key: value for key, value in values["radar"].items() if value is not None}
        own = {key: radar.pop(key) for key in list(radar) if key in of_modes}
        known = {f.name for f in fields(TraceSettings)}
        given: dict[str, Any] = {k: v for k, v in values["tracing"].items() if v is not None}
        settings = {key: value for key, value in given.items() if key in known}
        effects = {key: value for key, value in given.items() if key not in known}
        return build_scene(
            shown.meshes,
            volumes=shown.volumes,
            radar=RadarDescription(**radar, mode_parameters=own),
            film=FilmDescription(**self._film(values)),
            settings=TraceSettings(**settings, seed=seed, effects=effects),
            ground=shown.ground,
            ground_level=0.0,
            name=name,
        )

    def _loaded(
        self,
        values: Mapping[str, Values],
        scene: int,
        attempt: int,
        levels: Mapping[str, int],
        seed: int,
        facts: dict[str, Value | None],
    ) -> Scene:
        """Scene file under a drawn radar; adds the file to the facts."""
        recipe = self.recipe
        generator = np.random.default_rng(np.random.SeedSequence((recipe.seed, SCENE_DRAW, scene, attempt)))
        file = string_value(recipe.sections["scene"].draw(generator, levels), "file")
        facts["scene.file"] = file
        plugins = {"sar_antenna": values["radar"], "range_film": self._film(values)}
        plugins["sar_path"] = {**values["tracing"], "seed": seed}
        given = {
            f"{plugin}.{name}": _as_text(value)
            for plugin, rows in plugins.items()
            for name, value in rows.items()
            if value is not None
        }
        return load_scene(self._file(file), parameters=given)


# section of the ground and name of its mesh, and sections of shapes
GROUND, PLACED = "ground", ("objects", "walls", "clutter", "trees")
# sections drawn for every view, and classes of shapes that are no instances
_VIEW = ("radar", "film", "tracing", "focusing")
_KINDS = {"walls": "wall", "clutter": "clutter", "trees": "tree"}


def _material(values: Values) -> dict[str, Value]:
    """Parameters of ``radar_material`` from a section's material and roughness."""
    out: dict[str, Value] = {"material": string_value(values, "material")}
    if values.get("rms_height"):
        out["rms_height"] = float_value(values, "rms_height")
    return out


def _as_text(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def aspect_deg(shape: PlacedShape, scene: Scene) -> float:
    """Angle of the radar from a shape's x axis, seen from above, deg in 0 to 360: 0 where its front faces the radar."""
    to_radar = -scene.radar.across
    angle = float(np.arctan2(to_radar[1], to_radar[0])) - shape.heading
    return float(np.rad2deg(angle) % 360.0)
