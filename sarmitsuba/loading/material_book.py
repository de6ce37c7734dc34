"""Materials of a scene, one for every BSDF."""

import re
from dataclasses import dataclass, field
from pathlib import Path

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import GuessWarning, SarmitsubaWarning, SceneError
from sarmitsuba.core.parameters import did_you_mean, one_line
from sarmitsuba.loading import tables
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.maps import CLASS_MAP, MATERIAL_MAPS, add_maps, land_cover
from sarmitsuba.loading.names_of_materials import is_doubtful, kind_of
from sarmitsuba.loading.notes import warn_once
from sarmitsuba.loading.overrides import Overrides
from sarmitsuba.scene.materials.bsdfs import (
    ADAPTER_BSDFS,
    adapter_note,
    named_material,
    ordinary_material,
    radar_material,
    rough_note,
    sionna_itu_name,
    sionna_material,
)
from sarmitsuba.scene.materials.diffuse import FEW_ANGLES, diffuse_tables
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.typical import typical_surface
from sarmitsuba.scene.scatterers import SCATTERERS

_SIONNA = ("itu-radio-material", "radio-material", "absorber-radio-material")
_MAX_NESTING = 16
# names of BSDFs without an id, which say nothing of a material
_NUMBERED = re.compile(r"[a-z]+_\d+")


@dataclass
class MaterialBook:
    """Materials of a scene, one for every BSDF element.

    Parameters
    ----------
    frequency : Hz, of the permittivities
    overrides : from the command line
    notes : filled with one line for every assumption
    rms_height : m, of materials without a roughness
    """

    frequency: float
    overrides: Overrides
    notes: list[str]
    rms_height: float
    materials: list[Material] = field(default_factory=list)
    _index: dict[int, int] = field(default_factory=dict)
    _named: dict[str, int] = field(default_factory=dict)
    _taken: set[str] = field(default_factory=set)  # names of the materials
    _kept: list[Element] = field(
        default_factory=list
    )  # elements are kept: a deleted one would leave its Python id to another

    def index(self, bsdf: Element | None, where: str) -> int:
        """Index of the material of a BSDF element; None is Mitsuba's default, ``diffuse``."""
        key = id(bsdf)
        if key not in self._index:
            if bsdf is None:
                label = where.partition(":")[0]
                bsdf = Element("bsdf", "diffuse", "", f"{label}: default bsdf", Path(), {})
            material = self._material(bsdf, bsdf.id or f"{bsdf.plugin}_{len(self.materials) + 1}", 0)
            self._index[key] = self.add(material, where.partition(":")[0])
            self._kept.append(bsdf)
        return self._index[key]

    def add(self, material: Material, label: str) -> int:
        """Index of an existing material; ``label`` starts every warning."""
        for part in {(m.name, m.diffuse_law, m.pec): m for m in list_with_parts([material])}.values():
            self._check_law(part, label)
        self.materials.append(material)
        self._taken.add(material.name)
        return len(self.materials) - 1

    def find_named(self, name: str, kind: str, label: str) -> int:
        """Index of the material of a name in a mesh file, with its typical surface.

        Parameters
        ----------
        name : in the mesh file
        kind : name in the library of materials
        label : start of every warning
        """
        if name not in self._named:
            free = name if name not in self._taken else f"{name}_{len(self._taken) + 1}"
            surface = typical_surface(kind, self.frequency, self.rms_height)
            material, note = named_material(free, kind, self.frequency, surface)
            if note:
                warn_once(self.notes, f"{label}: {note}")
            self._named[name] = self.add(material, label)
        return self._named[name]

    def _say(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _check_law(self, material: Material, label: str) -> None:
        """Warn where a diffuse law is used outside its domain of validity."""
        try:
            table = diffuse_tables(material, SPEED_OF_LIGHT / self.frequency, FEW_ANGLES)
        except SceneError as error:
            raise SceneError(f"{label}: {error}") from None
        for note in table.notes:
            warn_once(self.notes, f"{label}: {note}")

    def _material(self, bsdf: Element, name: str, depth: int) -> Material:
        plugin, where = bsdf.plugin, bsdf.where
        if depth > _MAX_NESTING:
            raise SceneError(f"{where}: BSDFs are nested more than {_MAX_NESTING} deep; flatten them")
        _refuse_scatterers(plugin, where)
        itu = sionna_itu_name(bsdf.id) if plugin not in tables.TABLES else ""
        if itu:
            surface = typical_surface(itu, self.frequency, self.rms_height)
            material, note = named_material(name, itu, self.frequency, surface)
        elif plugin == tables.RADAR_MATERIAL.plugin:
            material, note = self._radar_material(bsdf, name)
        elif plugin == tables.LAND_COVER.plugin:
            return self._land_cover(bsdf, name, depth)
        elif plugin in _SIONNA:
            values, given = self.overrides.read(bsdf, tables.TABLES[plugin])
            if plugin == "itu-radio-material" and "type" not in given:
                raise SceneError(
                    f'{where}: no ITU material named; give <string name="type" value="concrete"/>'
                )
            material, note = sionna_material(name, plugin, values, given, self.frequency, self.rms_height)
            if (
                plugin != "absorber-radio-material"
                and "scattering_coefficient" not in given
                and self.rms_height
            ):
                # Sionna's usual case: a note, no warning
                self._say(f"{where.partition(':')[0]}: {rough_note(plugin, self.rms_height)}")
        elif plugin in ADAPTER_BSDFS or plugin == tables.HOLDER.plugin:
            return self._collect_nested(bsdf, name, depth)
        elif plugin in tables.TABLES:
            raise SceneError(f"{where}: {plugin} is not a BSDF{did_you_mean(plugin, tables.TABLES)}")
        else:
            material, note = self._ordinary(bsdf, name), ""
        if note:
            warn_once(self.notes, f"{where.partition(':')[0]}: {note}")
        return material

    def _ordinary(self, bsdf: Element, name: str) -> Material:
        """Material of one of Mitsuba's own BSDFs; notes the meaning of its id, and warns of guesses."""
        title = bsdf.id or ("" if _NUMBERED.fullmatch(name) else name)
        called = kind_of(title, {})
        material, warning, note = ordinary_material(
            name, bsdf.plugin, bsdf.given(), self.frequency, self.rms_height, called
        )
        label = bsdf.where.partition(":")[0]
        if note and is_doubtful(title, {}):
            note += "; a guess from a word in it: name it by a material, or use radar_material"
            warn_once(self.notes, f'{label}: "{one_line(title)}": {note}', GuessWarning)
        elif note:
            self._say(f'{label}: "{one_line(title)}": {note}')
        if warning:
            category = SarmitsubaWarning if material.invisible else GuessWarning
            warn_once(self.notes, f"{label}: {warning}", category)
        return material

    def _radar_material(self, bsdf: Element, name: str) -> tuple[Material, str]:
        """Material of a ``radar_material`` and its warning; notes assumptions."""
        where = bsdf.where
        values, given = self.overrides.read(bsdf, tables.RADAR_MATERIAL, MATERIAL_MAPS)
        material, note, assumed = radar_material(name, values, given, self.frequency, where, self.rms_height)
        written, read = self.overrides.given(bsdf, tables.RADAR_MATERIAL).get("material"), values["material"]
        if isinstance(written, str) and written != read:
            self._say(f'{where}: material "{one_line(written)}" is read as {read}')
        if assumed:
            self._say(f"{where}: {assumed}")
        return add_maps(material, bsdf, values), note

    def _land_cover(self, bsdf: Element, name: str, depth: int) -> Material:
        classes = tuple(key for key, child in bsdf.children if child.kind == "bsdf")
        values, _ = self.overrides.read(bsdf, tables.LAND_COVER, (CLASS_MAP, *classes))

        def made(inner: Element) -> Material:
            return self._material(inner, inner.id or f"{inner.plugin}_{len(self.materials) + 1}", depth + 1)

        return land_cover(name, bsdf, values, made)

    def _collect_nested(self, bsdf: Element, name: str, depth: int) -> Material:
        if bsdf.plugin in ADAPTER_BSDFS and bsdf.plugin != "twosided":  # which is exact: nothing is ignored
            warn_once(self.notes, f"{bsdf.where.partition(':')[0]}: {adapter_note(bsdf.plugin)}")
        inner = list(bsdf.of_kind("bsdf"))
        if not inner:
            raise SceneError(f"{bsdf.where}: {bsdf.plugin} holds no BSDF; nest one in it")
        pick = inner[0]
        if bsdf.plugin == "mask":
            opacity = bsdf.given().get("opacity", 0.5)
            if isinstance(opacity, int | float) and opacity < 0.5:
                return Material(name, invisible=True)
        if bsdf.plugin == "blendbsdf" and len(inner) > 1:
            weight = bsdf.given().get("weight", 0.0)
            if isinstance(weight, int | float) and weight >= 0.5:
                pick = inner[1]
        return self._material(pick, name, depth + 1)


def _refuse_scatterers(plugin: str, where: str) -> None:
    """Raise a SceneError for a BSDF that is no surface."""
    point = plugin == tables.POINT_SCATTERER.plugin
    if point or plugin in SCATTERERS:
        shape = "a sphere" if point else SCATTERERS[plugin].on
        raise SceneError(f"{where}: {plugin} cannot be nested; put it directly on {shape}")
