"""Switches of the trace kernel, one per effect; an effect that is off is not compiled into the kernel."""

from dataclasses import dataclass

from sarmitsuba.radar.polarisation import linear_parts

# on or off, or the polarisation channels
FlagValue = bool | tuple[str, ...]


@dataclass(frozen=True)
class KernelFlags:
    """Effects compiled into the trace kernel, and the polarisation channels it records.

    Every field is declared and explained by the effect that sets it (`Effect.kernel_flags`) except these three and
    ``extra``:

    Parameters
    ----------
    channels : to record, such as ``HV`` (transmit H, receive V), see :mod:`sarmitsuba.radar.polarisation`
    double_phase : lengths and phases in float64; off demonstrates the error of float32
    taper : taper of the rays at the edge of the launch window
    extra : flags that are on without a field here, of kinds of scatterers and extensions; see :meth:`on`
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
    texture: bool = False
    temporal: bool = False
    water_motion: bool = False
    slabs: bool = False
    transmission: bool = False
    extra: frozenset[str] = frozenset()

    def on(self, name: str) -> bool:
        """Whether a flag is on, with a field here or without."""
        return name in self.extra or bool(getattr(self, name, False))

    @property
    def tracked(self) -> tuple[str, ...]:
        """Transmit polarisations whose fields are traced, including those needed for reciprocal paths."""
        letters = {c[0] for c in self.closed}
        if self._reversed:
            letters |= {c[1] for c in self.closed}
        return tuple(sorted(letters))

    @property
    def closed(self) -> tuple[str, ...]:
        """Channels that the kernel computes, from which the recorded channels are formed.

        A compact channel is computed directly unless reciprocal paths are on, which need linear channels.
        """
        if not self._reversed:
            return self.channels
        return tuple(dict.fromkeys(part for c in self.channels for _, part in linear_parts(c)))

    @property
    def _reversed(self) -> bool:
        """Whether reversed paths are evaluated."""
        return self.multi_bounce and (self.coherent or (self.diffuse and self.diffuse_double))

    def reciprocal(self, channel: str) -> tuple[str, str]:
        """Channels of a path and of its reverse."""
        return (channel, channel[::-1] if self.multi_bounce else channel)
