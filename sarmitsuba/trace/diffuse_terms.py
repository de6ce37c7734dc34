"""What a footprint returns diffusely for each channel, less what its scatterers have of their own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from sarmitsuba.backend import dr, mi
from sarmitsuba.trace import field
from sarmitsuba.trace.geometry import MATERIAL_MASK
from sarmitsuba.trace.scattering_matrix import ScatteringMatrix
from sarmitsuba.trace.water import tilted_hit

if TYPE_CHECKING:
    from sarmitsuba.effects.flags import KernelFlags
    from sarmitsuba.trace.state import Hit, Kernel, Lane, RayState

# a receiving vector: real, or complex where something stands in the way
Receiving: TypeAlias = "mi.Vector3f | field.ComplexVector"


@dataclass(frozen=True, eq=False)
class Receiver:
    """Receiving polarisations (by letter) and one-way gain in the direction from a hit to the antenna."""

    basis: dict[str, Receiving]
    gain: mi.Float


Terms: TypeAlias = "list[list[mi.Complex2f]]"


def diffuse_terms(
    kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, receive: Receiver
) -> tuple[Terms, Terms | None, Terms | None]:
    """Per channel, values of the fixed tensors straight home, back along the chain, and the other way round."""
    flags, both_ways = kernel.flags, kernel.both_ways
    fields = dict(zip(flags.tracked, ray.fields, strict=True))
    # only behind a mirror, or with two antennas, do the two directions differ
    backscatter = hit.first if flags.multi_bounce else None
    if kernel.bistatic:
        backscatter = mi.Bool(False)
    water = kernel.scene.water
    seen = hit if water is None else tilted_hit(water, hit, hit.material & MATERIAL_MASK, lane.time)
    matrix = ScatteringMatrix(kernel.scene, seen, hit.to_antenna, flags, backscatter)
    straight: list[list[mi.Complex2f]] = []
    retro = None
    reverse: list[list[mi.Complex2f]] | None = [] if both_ways and kernel.bistatic else None
    for channel in flags.closed:
        sent, received = channel[0], channel[1]
        terms = _between(matrix, receive.basis[received], fields[sent])
        if both_ways:
            # behind mirrors the reversed path comes home with the same length: the transposed channel
            swapped = _between(matrix, receive.basis[sent], fields[received])
            if reverse is not None:
                reverse.append(swapped)
            else:
                none = mi.Complex2f(0.0)
                terms = [t + dr.select(hit.first, none, r) for t, r in zip(terms, swapped, strict=True)]
        straight.append(terms)
    if both_ways:
        matrix = ScatteringMatrix(kernel.scene, seen, -hit.direction, flags, None)
        retro = [matrix.between_fields(fields[channel[1]], fields[channel[0]]) for channel in flags.closed]
    return (
        _recorded(flags, straight),
        None if retro is None else _recorded(flags, retro),
        None if reverse is None else _recorded(flags, reverse),
    )


def _between(matrix: ScatteringMatrix, q: Receiving, e: field.ComplexVector) -> list[mi.Complex2f]:
    """Values of the fixed tensors for a receiving vector."""
    return matrix.between_fields(q, e) if isinstance(q, tuple) else matrix.between(q, e)


def _recorded(flags: KernelFlags, terms: Terms) -> Terms:
    """Terms of the channels to record from those of the channels that were closed."""
    columns = [field.recorded(flags.closed, column, flags.channels) for column in zip(*terms, strict=True)]
    return [list(row) for row in zip(*columns, strict=True)]


def mixed(terms: list[mi.Complex2f], random: list[mi.Complex2f]) -> mi.Complex2f:
    """Sum of the fixed tensors' values times the cell's random numbers."""
    return sum((t * r for t, r in zip(terms[1:], random[1:], strict=True)), terms[0] * random[0])


__all__ = ["Receiver", "Receiving", "Terms", "diffuse_terms", "mixed"]
