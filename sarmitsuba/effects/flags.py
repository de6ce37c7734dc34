"""What the trace kernel is asked to do: one switch per effect. A switch that is off leaves no instruction behind."""

from dataclasses import dataclass

# on or off, or the polarisation channels
FlagValue = bool | tuple[str, ...]


@dataclass(frozen=True)
class KernelFlags:
    """Effects compiled into the trace kernel, and the polarisation channels it records.

    Every field is declared and explained by the effect that sets it (`Effect.kernel_flags`) but for these three and
    ``extra``:

    Parameters
    ----------
    channels : ``HH``, ``HV`` (transmit H, receive V), ``VH``, ``VV``
    double_phase : lengths and phases in float64; off is for showing what float32 does
    taper : fade the rays out at the edge of the launch window
    extra : flags that are on and that only an extension knows: of effects of a user's own, for kernel code of a
        user's own; the built-in kernel looks at none of them
    """

    channels: tuple[str, ...] = ("VV",)
    fresnel: bool = True
    roughness: bool = True
    coherent: bool = True
    diffuse: bool = True
    diffuse_double: bool = True
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
    motion: bool = False
    extra: frozenset[str] = frozenset()

    @property
    def tracked(self) -> tuple[str, ...]:
        """Transmit polarisations whose field is carried along: all that a reciprocal path needs."""
        letters = {c[0] for c in self.channels}
        if self.multi_bounce and (self.coherent or (self.diffuse and self.diffuse_double)):
            letters |= {c[1] for c in self.channels}
        return tuple(sorted(letters))

    def reciprocal(self, channel: str) -> tuple[str, str]:
        """Channels of a path and of the reversed one; after one bounce they are one path."""
        return (channel, channel[::-1] if self.multi_bounce else channel)


__all__ = ["FlagValue", "KernelFlags"]
