"""Building materials and ground of ITU-R P.2040."""

from dataclasses import dataclass

from sarmitsuba.scene.materials.named_materials import (
    MATERIALS,
    NamedMaterial,
    permittivity_from_conductivity,
)

Band = tuple[float, float, float, float, float, float]

# ITU-R P.2040-3, table 3; the last four names and the bands above 110 GHz from P.2040-4.
# name: ((from GHz, to GHz, a, b, c, d), ...)
ITU_BANDS: dict[str, tuple[Band, ...]] = {
    "vacuum": ((0.001, 100.0, 1.0, 0.0, 0.0, 0.0),),
    "concrete": ((1.0, 100.0, 5.24, 0.0, 0.0462, 0.7822), (110.0, 330.0, 5.17, 0.0, 0.0145, 1.0900)),
    "brick": ((1.0, 40.0, 3.91, 0.0, 0.0238, 0.16), (110.0, 330.0, 4.15, 0.0, 0.0006, 1.5712)),
    "plasterboard": ((1.0, 100.0, 2.73, 0.0, 0.0085, 0.9395), (110.0, 330.0, 2.56, 0.0, 0.0001, 1.7799)),
    "wood": ((0.001, 100.0, 1.99, 0.0, 0.0047, 1.0718), (110.0, 330.0, 1.82, 0.0, 0.0040, 1.0761)),
    "glass": ((0.1, 100.0, 6.31, 0.0, 0.0036, 1.3394), (220.0, 450.0, 5.79, 0.0, 0.0004, 1.658)),
    "ceiling_board": ((1.0, 100.0, 1.48, 0.0, 0.0011, 1.0750), (220.0, 450.0, 1.52, 0.0, 0.0029, 1.029)),
    "chipboard": ((1.0, 100.0, 2.58, 0.0, 0.0217, 0.7800), (100.0, 200.0, 2.16, 0.0, 0.0023, 1.359)),
    "plywood": ((1.0, 40.0, 2.71, 0.0, 0.33, 0.0), (110.0, 330.0, 1.94, 0.0, 0.0067, 0.9982)),
    "marble": ((1.0, 60.0, 7.074, 0.0, 0.0055, 0.9262), (110.0, 330.0, 7.94, 0.0, 0.0001, 1.7330)),
    "floorboard": ((50.0, 100.0, 3.66, 0.0, 0.0044, 1.3515), (100.0, 400.0, 3.1575, 0.0, 0.001675, 1.32775)),
    "metal": ((1.0, 100.0, 1.0, 0.0, 1e7, 0.0),),
    "very_dry_ground": ((1.0, 10.0, 3.0, 0.0, 0.00015, 2.52),),
    "medium_dry_ground": ((1.0, 10.0, 15.0, -0.1, 0.035, 1.63),),
    "wet_ground": ((1.0, 10.0, 30.0, -0.4, 0.15, 1.30),),
    "clear_acrylic": ((110.0, 330.0, 2.58, 0.0, 0.0001, 1.6524),),
    "vinyl_tile": ((1.0, 40.0, 3.62, 0.0, 0.0051, 0.8422),),
    "carpet_tile": ((1.0, 40.0, 2.08, 0.0, 0.0009, 0.8200),),
    "asphalt_concrete": ((1.0, 40.0, 4.83, 0.0, 0.0108, 1.3969),),
}


@dataclass(frozen=True)
class ItuMaterial(NamedMaterial):
    r"""A material of ITU-R P.2040.

    .. math:: \epsilon' = a f_\mathrm{GHz}^b, \quad \sigma = c f_\mathrm{GHz}^d

    Parameters
    ----------
    name, title : see `NamedMaterial`
    bands : from and to (GHz), a, b, c, d of each band measured

    Notes
    -----
    Ignores moisture and temperature; outside its bands the nearest one is extrapolated.

    References
    ----------
    ITU-R P.2040-3, equations 28 and 29 with table 3.
    """

    name: str
    title: str
    bands: tuple[Band, ...]

    def permittivity(self, frequency: float) -> complex:
        """See the class."""
        ghz = frequency / 1e9
        _, _, a, b, c, d = self._band(ghz)
        return permittivity_from_conductivity(a * ghz**b, c * ghz**d, frequency)

    def note(self, frequency: float) -> str:
        """Warning outside the measured bands."""
        ghz = frequency / 1e9
        low, high = self._band(ghz)[:2]
        if low <= ghz <= high:
            return ""
        return f"ITU-R P.2040 gives {self.name} from {low:g} to {high:g} GHz; extrapolated to {ghz:g} GHz"

    def _band(self, ghz: float) -> Band:
        return min(self.bands, key=lambda band: max(band[0] - ghz, ghz - band[1], 0.0))


for _name, _bands in ITU_BANDS.items():
    MATERIALS.register(ItuMaterial(_name, "ITU-R P.2040", _bands))
