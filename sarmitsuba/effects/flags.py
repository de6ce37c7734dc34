"""What the trace kernel is asked to do: one switch an effect. A switch that is off leaves no instruction behind."""

from dataclasses import dataclass


@dataclass(frozen=True)
class KernelFlags:
    """Effects compiled into the trace kernel, and the polarisation channels it records.

    Parameters
    ----------
    channels : ``HH``, ``HV`` (transmit H, receive V), ``VH``, ``VV``
    fresnel : Fresnel coefficients; off treats every surface as a perfect conductor
    roughness : coherent loss of rough surfaces
    coherent : physical-optics return of the smooth part of the surfaces
    diffuse : persistent diffuse scatterers
    diffuse_double : reciprocal and retro paths of diffuse hits behind a mirror chain
    footprint_splitting : share each tube among the scatterer cells that it overlaps; off gives it to the cell of its
        middle
    speckle : complex Gaussian scatterers; off gives each cell the same modulus and a random phase
    depolarisation : cross-polar diffuse return
    polarised_diffuse : diffuse laws that differ between h and v
    antenna_pattern : gain over direction
    spreading : spherical spreading inside the scene; off uses the reference point's range for all
    visibility : shadow rays from the second hit on
    tube_phase : the phase integral over a ray's footprint
    double_phase : lengths and phases in float64; off is for showing what float32 does
    taper : fade the rays out at the edge of the launch window
    multi_bounce : more than one hit; off leaves the loop and the reflection out
    """

    channels: tuple[str, ...] = ("VV",)
    fresnel: bool = True
    roughness: bool = True
    coherent: bool = True
    diffuse: bool = True
    diffuse_double: bool = True
    footprint_splitting: bool = True
    speckle: bool = True
    depolarisation: bool = True
    polarised_diffuse: bool = True
    antenna_pattern: bool = True
    spreading: bool = True
    visibility: bool = True
    tube_phase: bool = True
    double_phase: bool = True
    taper: bool = True
    multi_bounce: bool = True

    @property
    def tracked(self) -> tuple[str, ...]:
        """Transmit polarisations whose field is carried along: all that a reciprocal path needs."""
        letters = {c[0] for c in self.channels}
        if self.diffuse and self.diffuse_double and self.multi_bounce:
            letters |= {c[1] for c in self.channels}
        return tuple(sorted(letters))


__all__ = ["KernelFlags"]
