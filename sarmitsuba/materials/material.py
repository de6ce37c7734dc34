"""The electromagnetic surface of a half space or of a slab, as data."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.errors import SceneError
from sarmitsuba.materials.diffuse_law import LAWS


@dataclass(frozen=True)
class Material:
    """Electromagnetic surface of a half space or a slab, at the carrier frequency.

    Parameters
    ----------
    name : unique in a scene
    pec : perfect electric conductor; ``permittivity`` is then ignored
    permittivity : relative, ``eps' - j eps''`` with ``eps'' >= 0`` (time convention exp(+j w t))
    rms_height : m; standard deviation of the surface height, reduces the coherent reflection
    diffuse_law : name in ``LAWS``: how the incoherent return depends on angle
    diffuse_level_db : level of an empirical law, dB; what it means is in the law's ``level``
    correlation_length : m; of the surface height, for the laws derived from a height spectrum
    cross_polar_ratio_db : cross- over co-polar diffuse power, dB; -inf for none
    invisible : neither reflects nor blocks (permittivity 1)
    law_parameters : name and value of what the law has declared of its own; left out: the law's defaults
    thickness : m, of a slab, of which every facet is one; 0: a half space
    sheet_resistance : ohm per square, of a conducting coat on the slab's face away from the facet's normal; 0: none

    Raises
    ------
    SceneError : no law of that name, or a parameter that the law does not know

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
    law_parameters: tuple[tuple[str, float], ...] = ()
    thickness: float = 0.0
    sheet_resistance: float = 0.0

    def __post_init__(self) -> None:
        if self.diffuse_law not in LAWS:
            known_laws = ", ".join(sorted(LAWS.names))
            raise SceneError(
                f'material "{self.name}": diffuse_law = "{self.diffuse_law}" is not one of {known_laws}'
            )
        known = [p.name for p in LAWS[self.diffuse_law].parameters]
        for name, _ in self.law_parameters:
            if name not in known:
                takes = f"it takes {', '.join(known)}" if known else "it takes none of its own"
                raise SceneError(
                    f'material "{self.name}": diffuse_law = {self.diffuse_law} has no parameter {name}; {takes}'
                )

    @property
    def scatters(self) -> bool:
        """The diffuse law returns something at all."""
        return LAWS[self.diffuse_law].scatters

    def law_parameter(self, name: str) -> float:
        """Value of a parameter of the law's own, its default when it is not given."""
        given = dict(self.law_parameters)
        if name in given:
            return given[name]
        default = next(p.default for p in LAWS[self.diffuse_law].parameters if p.name == name)
        assert isinstance(default, int | float)
        return float(default)


__all__ = ["Material"]
