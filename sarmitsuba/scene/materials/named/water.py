"""Water, fresh and salt: permittivity by temperature and salinity."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.constants import VACUUM_PERMITTIVITY
from sarmitsuba.core.parameters import Param
from sarmitsuba.scene.materials.named_materials import MATERIALS, NamedMaterial


def klein_swift(frequency: float, temperature: float, salinity: float) -> complex:
    r"""Relative permittivity of water.

    .. math:: \varepsilon = 4.9 + \frac{\varepsilon_s(T, S) - 4.9}{1 + j \omega \tau(T, S)}
              - j \frac{\sigma(T, S)}{\omega \varepsilon_0}

    Parameters
    ----------
    frequency : Hz, fitted from 1.4 to 2.7 GHz and used to about 20 GHz
    temperature : T, degrees Celsius, 0 to 40
    salinity : S, g of salt per kg, 0 to 40

    References
    ----------
    Klein and Swift, IEEE Trans. AP 25 (1) 1977, 104-111: equations 5, 13 to 18.
    """
    t, s, omega = temperature, salinity, 2.0 * np.pi * frequency
    static = 87.134 - 1.949e-1 * t - 1.276e-2 * t**2 + 2.491e-4 * t**3
    static *= 1.0 + 1.613e-5 * s * t - 3.656e-3 * s + 3.210e-5 * s**2 - 4.232e-7 * s**3
    relaxation = 1.768e-11 - 6.086e-13 * t + 1.104e-14 * t**2 - 8.111e-17 * t**3
    relaxation *= 1.0 + 2.282e-5 * s * t - 7.638e-4 * s - 7.760e-6 * s**2 + 1.105e-8 * s**3
    below = 25.0 - t
    conductivity = s * (0.182521 - 1.46192e-3 * s + 2.09324e-5 * s**2 - 1.28205e-7 * s**3)
    slope = 2.033e-2 + 1.266e-4 * below + 2.464e-6 * below**2
    slope -= s * (1.849e-5 - 2.551e-7 * below + 2.551e-8 * below**2)
    conductivity *= np.exp(-below * slope)
    debye = 4.9 + (static - 4.9) / (1.0 + 1j * omega * relaxation)
    return complex(debye - 1j * conductivity / (omega * VACUUM_PERMITTIVITY))


_TEMPERATURE = Param("temperature_celsius", "float", 15.0, "temperature of the water", "C", -2.0, 40.0)
_SALINITY = Param("salinity", "float", 35.0, "g of salt per kg of water", "g/kg", 0.0, 40.0)


@dataclass(frozen=True)
class Water(NamedMaterial):
    """Water of a temperature (degrees Celsius) and a salinity (g/kg); ``name`` and ``title``: see `NamedMaterial`.

    ``salt``: whether a scene may give the salinity too.
    """

    name: str
    title: str
    temperature: float
    salinity: float
    salt: bool = True

    @property
    def parameters(self) -> tuple[Param, ...]:
        """Temperature, and salinity of salt water."""
        return (_TEMPERATURE, _SALINITY) if self.salt else (_TEMPERATURE,)

    def at(self, values: Mapping[str, float]) -> "Water":
        """The same at another temperature and salinity."""
        temperature = values.get(_TEMPERATURE.name, self.temperature)
        return replace(self, temperature=temperature, salinity=values.get(_SALINITY.name, self.salinity))

    def permittivity(self, frequency: float) -> complex:
        """See `klein_swift`."""
        return klein_swift(frequency, self.temperature, self.salinity)

    def note(self, frequency: float) -> str:
        """Warning beyond 30 GHz."""
        if frequency <= 30e9:
            return ""
        return (
            f"Klein and Swift's fit of {self.name} is used to 30 GHz; extrapolated to {frequency / 1e9:g} GHz"
        )


MATERIALS.register(Water("sea_water", "Klein and Swift, 35 g/kg unless given", 15.0, 35.0))
MATERIALS.register(Water("fresh_water", "Klein and Swift, no salt", 15.0, 0.0, salt=False))
