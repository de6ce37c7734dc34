"""What the trace kernel is asked to do: one switch per effect. A switch that is off leaves no instruction behind."""

from dataclasses import dataclass

from sarmitsuba.radar.polarisation import linear_parts

# on or off, or the polarisation channels
FlagValue = bool | tuple[str, ...]


@dataclass(frozen=True)
class KernelFlags:
    """Effects compiled into the trace kernel, and the polarisation channels it records.

    Every field is declared and explained by the effect that sets it (`Effect.kernel_flags`) but for these three and
    ``extra``:

    Parameters
    ----------
    channels : to record, such as ``HV`` (transmit H, receive V), see :mod:`sarmitsuba.radar.polarisation`
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
    edge_diffraction: bool = False
    texture: bool = False
    temporal: bool = False
    water_motion: bool = False
    diffuse_pairs: bool = False
    slabs: bool = False
    transmission: bool = False
    extra: frozenset[str] = frozenset()

    @property
    def tracked(self) -> tuple[str, ...]:
        """Transmit polarisations whose field is carried along: all that a reciprocal path needs."""
        letters = {c[0] for c in self.closed}
        if self._reversed:
            letters |= {c[1] for c in self.closed}
        return tuple(sorted(letters))

    @property
    def closed(self) -> tuple[str, ...]:
        """Channels in which paths are closed, of which those to record are sums.

        A compact channel is one of them where its own wave is all that is needed; a reciprocal path needs linear ones.
        """
        if not self._reversed:
            return self.channels
        return tuple(dict.fromkeys(part for c in self.channels for _, part in linear_parts(c)))

    @property
    def _reversed(self) -> bool:
        """Whether a path and the reversed one are both looked at."""
        return self.multi_bounce and (self.coherent or (self.diffuse and self.diffuse_double))

    def reciprocal(self, channel: str) -> tuple[str, str]:
        """Channels of a path and of the reversed one; after one bounce they are one path."""
        return (channel, channel[::-1] if self.multi_bounce else channel)
