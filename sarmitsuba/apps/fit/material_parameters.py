"""Parameters of materials: level of the diffuse return, permittivity, roughness, thickness."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.apps.fit.parameter import Derivatives, Parameter, Step, quote_name
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.scene.materials.diffuse_law import LAWS
from sarmitsuba.scene.materials.map_materials import list_with_parts

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sarmitsuba.scene.materials.material import Material
    from sarmitsuba.scene.materials.texture import Bitmap
    from sarmitsuba.scene.scene import Scene


class _OfMaterial(Parameter):
    """Parameter of one material; ``kind`` and ``material``: names."""

    kind: str
    material: str

    @property
    def label(self) -> str:  # type: ignore[override]
        """See the base class."""
        return f"{self.kind}:{quote_name(self.material)}"


@dataclass(frozen=True)
class Level(_OfMaterial):
    """Level of a material's diffuse law, dB: ``diffuse_level_db``.

    Parameters
    ----------
    material : name
    """

    direct = True
    kind = "level"
    material: str

    def _own(self, scene: Scene) -> Material:
        m = material_of(scene, self.material, self.label)
        if not has_level(m):
            raise SceneError(
                f"parameter {self.label}: diffuse_law = {m.diffuse_law} has no level; differentiate by a property "
                "that it has"
            )
        return m

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return (f"{self.label} [dB]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        return np.array([self._own(scene).diffuse_level_db])

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        self._own(scene)
        check_levels(self.label, values)
        return change_material(scene, self.material, diffuse_level_db=float(values[0]))

    def levels(self, scene: Scene) -> Sequence[frozenset[int]]:
        """See the base class."""
        return (numbers_of(scene, self.material),)

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return found.levelled


@dataclass(frozen=True)
class LevelMap(_OfMaterial):
    """Levels of all texels of a material's ``sigma0_map``, dB, relative to the material's level.

    Parameters
    ----------
    material : name
    """

    direct = True
    kind = "level_map"
    material: str

    def _own(self, scene: Scene) -> tuple[int, Bitmap]:
        """Number of the material, and its map."""
        material_of(scene, self.material, self.label)
        found = [
            (i, m.maps.level)
            for i, m in enumerate(scene.materials)
            if m.name == self.material and m.maps is not None and m.maps.level is not None
        ]
        if len(found) != 1:
            problem = f"{len(found)} materials of that name have" if found else "the material has"
            raise SceneError(
                f"parameter {self.label}: {problem} {'a' if found else 'no'} sigma0_map; give it one"
            )
        number, bitmap = found[0]
        if not (bitmap.values > 0.0).all():
            raise SceneError(
                f"parameter {self.label}: the map has texels of 0, which have no level in dB; give them a small one"
            )
        return number, bitmap

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        rows, columns = self._own(scene)[1].values.shape
        return tuple(f"{self.label} row {i} column {j} [dB]" for i in range(rows) for j in range(columns))

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        return np.asarray(db_from_power(self._own(scene)[1].values.reshape(-1)), dtype=np.float64)

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        number, bitmap = self._own(scene)
        check_levels(self.label, values)
        bitmap = replace(bitmap, values=power_from_db(np.reshape(values, bitmap.values.shape)))
        m = scene.materials[number]
        assert m.maps is not None
        m = replace(m, maps=replace(m.maps, level=bitmap))
        return replace(scene, materials=(*scene.materials[:number], m, *scene.materials[number + 1 :]))

    def texels(self, scene: Scene) -> Sequence[tuple[int, int]]:
        """See the base class."""
        number, bitmap = self._own(scene)
        return [(number, k) for k in range(bitmap.values.size)]

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return found.mapped


# share of a property by which it is changed on either side, and of the wavelength for the thickness of a slab
STEP, THICKNESS_STEP = 0.01, 0.0005

# largest modulus of a level, dB
MOST_LEVEL = 200.0

# kinds of properties: what they are called in a fit's table
PROPERTIES = {
    "permittivity": "permittivity, real part",
    "loss": "permittivity, less the imaginary part",
    "rms_height": "rms height, m",
    "correlation_length": "correlation length, m",
    "thickness": "thickness of the slab, m",
}
# least values, of a vacuum or of nothing; those of lengths themselves are none
# largest value of any: a permittivity beyond is a metal's
MOST = 1e6
LEAST = {"permittivity": 1.0, "loss": 0.0, "rms_height": 0.0, "correlation_length": 0.0, "thickness": 0.0}


@dataclass(frozen=True)
class MaterialProperty(_OfMaterial):
    """Property of a material: one of ``PROPERTIES``.

    Parameters
    ----------
    kind, material : names
    """

    kind: str
    material: str

    def _own(self, scene: Scene) -> Material:
        m = material_of(scene, self.material, self.label)
        problem = ""
        if self.kind in ("permittivity", "loss"):
            problem = (
                "a perfect conductor has none"
                if m.pec
                else "it is given over frequency"
                if m.dispersion is not None
                else ""
            )
        elif not getattr(m, self.kind) > 0.0:
            problem = f"its {self.kind} is 0"
        if problem:
            raise SceneError(f"parameter {self.label}: {problem}; differentiate by another property")
        return m

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return (f"{self.label} [{'1' if self.kind in ('permittivity', 'loss') else 'm'}]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        m = self._own(scene)
        if self.kind == "permittivity":
            return np.array([m.permittivity.real])
        if self.kind == "loss":
            return np.array([-m.permittivity.imag])
        return np.array([getattr(m, self.kind)])

    def _field(self, m: Material, value: float) -> Mapping[str, float | complex]:
        """Change of the material to another value."""
        if self.kind == "permittivity":
            return {"permittivity": complex(value, m.permittivity.imag)}
        if self.kind == "loss":
            return {"permittivity": complex(m.permittivity.real, -value)}
        return {self.kind: value}

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class; SceneError: a value that no passive material has."""
        value, least = float(values[0]), LEAST[self.kind]
        if value > MOST:
            raise SceneError(f"parameter {self.label} = {value:g} must be at most {MOST:g}")
        if not least <= value or (least == 0.0 == value and self.kind != "loss"):
            bound = (
                "must be above 0" if least == 0.0 and self.kind != "loss" else f"must be at least {least:g}"
            )
            raise SceneError(f"parameter {self.label} = {value:g} {bound}")
        return change_material(scene, self.material, **self._field(self._own(scene), value))

    def steps(self, scene: Scene) -> Sequence[Step]:
        """See the base class."""
        m, value = self._own(scene), float(self.values(scene)[0])
        step = STEP * (abs(m.permittivity) if self.kind in ("permittivity", "loss") else value)
        if self.kind == "thickness":
            step = min(step, THICKNESS_STEP * scene.radar.waveform.wavelength)
        low = value - step
        if self.kind == "loss":  # no medium that amplifies
            low = max(low, 0.0)
        return (Step(self.material, self._field(m, low), self._field(m, value + step), value + step - low),)

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return found.changed


def check_levels(label: str, values: F64) -> None:
    """Refuse levels beyond ``MOST_LEVEL``, whose powers overflow."""
    worst = float(values[np.argmax(np.abs(values))])
    if not abs(worst) <= MOST_LEVEL:
        raise SceneError(f"parameter {label} = {worst:g} dB must be within {MOST_LEVEL:g} dB of 0")


def has_level(m: Material) -> bool:
    """Whether the diffuse law of a material has a level."""
    return bool(LAWS[m.diffuse_law].level) and bool(np.isfinite(m.diffuse_level_db))


def material_of(scene: Scene, name: str, label: str) -> Material:
    """The material of a name.

    Raises
    ------
    SceneError : there is none
    """
    for m in list_with_parts(scene.materials):
        if m.name == name:
            return m
    known = ", ".join(sorted({m.name for m in list_with_parts(scene.materials)}))
    raise SceneError(f'parameter {label}: no material "{name}"; there are {known}')


def numbers_of(scene: Scene, name: str) -> frozenset[int]:
    """Numbers of the kernel's materials of a name."""
    return frozenset(i for i, m in enumerate(list_with_parts(scene.materials)) if m.name == name)


def change_material(scene: Scene, name: str, **changes: float | complex) -> Scene:
    """The scene with changes to all materials of a name, those of maps included."""

    def changed(m: Material) -> Material:
        if m.name == name:
            m = replace(m, **changes)  # type: ignore[arg-type]
        if m.maps is None or m.maps.classes is None:
            return m
        parts = tuple(changed(p) for p in m.maps.classes.materials)
        return replace(m, maps=replace(m.maps, classes=replace(m.maps.classes, materials=parts)))

    return replace(scene, materials=tuple(changed(m) for m in scene.materials))
