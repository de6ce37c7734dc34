"""Electromagnetic properties of the surface of a half space or slab, and their source at other frequencies."""

from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import knows_its_fields
from sarmitsuba.scene.materials.change import coherence_after
from sarmitsuba.scene.materials.diffuse_law import LAWS
from sarmitsuba.scene.materials.named_materials import MATERIALS, permittivity_from_conductivity
from sarmitsuba.scene.materials.texture import Bitmap, check_texture


@dataclass(frozen=True)
class Dispersion:
    """Relative permittivity as a function of frequency.

    Parameters
    ----------
    kind : name in ``MATERIALS``; empty: given by ``real`` and ``conductivity``
    values : name and value of the named material's parameters; missing ones have their defaults
    real : relative permittivity, real part
    conductivity : S/m
    """

    kind: str = ""
    values: tuple[tuple[str, float], ...] = ()
    real: float = 1.0
    conductivity: float = 0.0

    def permittivity(self, frequency: float) -> complex:
        """Relative permittivity ``eps' - j eps''`` at a frequency, Hz."""
        if self.kind:
            return MATERIALS[self.kind].at(dict(self.values)).permittivity(frequency)
        return permittivity_from_conductivity(self.real, self.conductivity, frequency)


# magnitude of the permittivity above which a half space reflects 98 % of a wave and its edges are those of metal
GOOD_CONDUCTOR = 1e4


@knows_its_fields
@dataclass(frozen=True)
class Material:
    """Electromagnetic surface of a half space or a slab, at the carrier frequency.

    Parameters
    ----------
    name : unique in a scene
    pec : perfect electric conductor; ``permittivity`` is then ignored
    permittivity : relative, ``eps' - j eps''`` with ``eps'' >= 0`` (time convention exp(+j w t))
    rms_height : m; standard deviation of the surface height, reduces the coherent reflection; 0: the law's default,
        mostly 0
    diffuse_law : name in ``LAWS``: angular dependence of the incoherent return
    diffuse_level_db : level of an empirical law, dB; its quantity is stated in the law's ``level``
    correlation_length : m; of the surface height, for the laws derived from a height spectrum
    cross_polar_ratio_db : cross- over co-polar diffuse power, dB; -inf for none
    invisible : neither reflects nor blocks (permittivity 1)
    temporal_coherence : of the incoherent return between two passes long apart, 0 ... 1; 1: no change
    decorrelation_days : time constant of the decay to it; 0: at once
    law_parameters : name and value of the law's parameters; missing ones have their defaults
    texture_shape : shape nu of the gamma texture that multiplies the diffuse return (K distribution); 0 for none
    texture_length : m; correlation length of that texture
    maps : bitmaps of the properties over the surface; None: constant
    thickness : m, of the slab that every facet represents; 0: a half space
    sheet_resistance : ohm per square, of a conducting coat on the slab's face away from the facet's normal; 0: none
    facet_depth : position of the facets in the slab, 0 ... 1: share of the thickness on their normal's side
    dispersion : the permittivity over frequency; None: constant

    Raises
    ------
    SceneError : no law of that name, a parameter that the law does not have, or an incomplete texture

    Notes
    -----
    Ignores anisotropy and magnetic materials.
    """

    name: str
    pec: bool = False
    permittivity: complex = 1.0 + 0.0j
    rms_height: float = 0.0
    diffuse_law: str = "none"
    diffuse_level_db: float = -np.inf
    correlation_length: float = 0.0
    cross_polar_ratio_db: float = -np.inf
    invisible: bool = False
    temporal_coherence: float = 1.0
    decorrelation_days: float = 0.0
    law_parameters: tuple[tuple[str, float], ...] = ()
    texture_shape: float = 0.0
    texture_length: float = 0.0
    maps: "SurfaceMaps | None" = None
    thickness: float = 0.0
    sheet_resistance: float = 0.0
    facet_depth: float = 0.0
    dispersion: Dispersion | None = None

    def __post_init__(self) -> None:
        if self.diffuse_law not in LAWS:
            known_laws = ", ".join(sorted(LAWS.names))
            raise SceneError(
                f'material "{self.name}": diffuse_law = "{self.diffuse_law}" is not one of {known_laws}'
            )
        check_texture(self.texture_shape, self.texture_length, f'material "{self.name}"')
        known = [p.name for p in LAWS[self.diffuse_law].parameters]
        for name, _ in self.law_parameters:
            if name not in known:
                takes = f"it has {', '.join(known)}" if known else "it has none"
                raise SceneError(
                    f'material "{self.name}": diffuse_law = {self.diffuse_law} has no parameter {name}; {takes}'
                )
        if self.rms_height == 0.0:
            object.__setattr__(self, "rms_height", LAWS[self.diffuse_law].implied_rms_height(self))

    def at_frequency(self, frequency: float) -> "Material":
        """The material with its permittivity at another frequency, Hz; that of its maps' materials too."""
        changed = self
        if self.dispersion is not None:
            changed = replace(changed, permittivity=self.dispersion.permittivity(frequency))
        if self.maps is not None and self.maps.classes is not None:
            classes = self.maps.classes
            parts = tuple(m.at_frequency(frequency) for m in classes.materials)
            changed = replace(changed, maps=replace(self.maps, classes=replace(classes, materials=parts)))
        return changed

    @property
    def metallic(self) -> bool:
        """Whether it is metal: a half space of a perfect or good conductor."""
        return self.pec or (self.thickness == 0.0 and abs(self.permittivity) > GOOD_CONDUCTOR)

    @property
    def scatters(self) -> bool:
        """Whether it has a diffuse return."""
        return LAWS[self.diffuse_law].scatters

    def coherence_after(self, days: float) -> float:
        """Coherence of the incoherent return between two passes, ``days`` apart."""
        return coherence_after(days, self.temporal_coherence, self.decorrelation_days)

    def law_parameter(self, name: str) -> float:
        """Value of a parameter of the law, by default its default."""
        given = dict(self.law_parameters)
        if name in given:
            return given[name]
        default = next(p.default for p in LAWS[self.diffuse_law].parameters if p.name == name)
        assert isinstance(default, int | float)
        return float(default)


@dataclass(frozen=True, eq=False)
class ClassMap:
    """Map of material classes over a surface.

    Parameters
    ----------
    bitmap : of numbers of ``materials``, not smooth
    materials : none invisible, none with maps
    """

    bitmap: Bitmap
    materials: tuple[Material, ...]

    def __post_init__(self) -> None:
        for material in self.materials:
            what = (
                "is invisible: a map cannot make holes"
                if material.invisible
                else "has a map of its own"
                if material.maps is not None
                else "has a thickness: a surface is a slab as a whole"
                if material.thickness
                else ""
            )
            if what:
                raise SceneError(f'material "{material.name}" of a map of materials {what}; leave that out')
        values = self.bitmap.values
        if self.bitmap.smooth or not (0 <= values.min() and values.max() < len(self.materials)):
            raise SceneError(
                f"a map of materials holds numbers from 0 to {len(self.materials) - 1}, not smooth"
            )

    @property
    def most_frequent(self) -> Material:
        """The material of most texels."""
        return self.materials[int(np.bincount(self.bitmap.values.astype(np.int64).ravel()).argmax())]


@dataclass(frozen=True, eq=False)
class SurfaceMaps:
    """Bitmaps of a material's properties.

    Parameters
    ----------
    level : factor on sigma0, of at least 0; None: 1 everywhere
    classes : material at every place; None: the material itself everywhere
    """

    level: Bitmap | None = None
    classes: ClassMap | None = None

    def __post_init__(self) -> None:
        if self.level is not None:
            values = np.asarray(self.level.values)
            if not (np.isfinite(values) & (values >= 0.0)).all():
                raise SceneError(
                    "sigma0_map: a factor on sigma0 is below 0 or no finite number; repair the map"
                )

    def moved(self, offset: F64) -> "SurfaceMaps":
        """The maps in a scene frame whose origin is at ``offset``, (3,) m."""
        level, classes = self.level, self.classes
        if level is not None:
            level = replace(level, placement=level.placement.moved(offset))
        if classes is not None:
            bitmap = replace(classes.bitmap, placement=classes.bitmap.placement.moved(offset))
            classes = replace(classes, bitmap=bitmap)
        return SurfaceMaps(level, classes)
