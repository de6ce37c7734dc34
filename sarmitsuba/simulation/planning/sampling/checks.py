"""Warnings about ray spacings that are too large."""

import warnings
from collections.abc import Iterator, Sequence

from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.simulation.execution.statistics import LatticeSpacings
from sarmitsuba.simulation.planning.sampling.density_plan import FINE_RAYS, SamplingPlan
from sarmitsuba.simulation.planning.sampling.small_parts import Shortfall

# share of the surface that is too coarsely sampled, and bias of its coherent return, that give a warning
SMALL_SHARE = 0.01
SMALL_BIAS_DB = 1.0
# ray spacing in wavelengths from which shadows and reflections of small objects may be wrong by dB (of 53 random
# scenes all with an error above 0.5 dB had a spacing of 1.7 wavelengths or more)
WIDE_TUBE = 1.5


def check_sampling(sampling: SamplingPlan, spacings: LatticeSpacings) -> list[str]:
    """Warn of ray spacings too large for the resolution; returns the warnings' texts."""
    notes = [f"{sampling.scene.name}: {text}" for text in _too_wide(sampling, spacings)]
    for note in notes:
        warnings.warn(note, SarmitsubaWarning, stacklevel=4)
    return notes


def _too_wide(sampling: SamplingPlan, spacings: LatticeSpacings) -> Iterator[str]:
    coherent, half_cell = spacings.of_coherent, sampling.half_cell
    if coherent > 1.01 * half_cell:
        yield (
            f"ray_spacing = {coherent:g} m is coarser than half a resolution cell; "
            f"set it to {half_cell:.3g} m or less"
        )
    wavelength, scene = sampling.scene.radar.waveform.wavelength, sampling.scene
    affordable = sampling.window.area <= FINE_RAYS * sampling.fine_spacing**2
    several = len(scene.geometry.mesh_names) > 1
    if sampling.flags.coherent and several and affordable and coherent > WIDE_TUBE * wavelength:
        yield (
            f"ray_spacing = {coherent:g} m is {coherent / wavelength:.1f} wavelengths: echoes of objects that shadow "
            f"or mirror each other may be several dB off; leave it out, or set it to {sampling.fine_spacing:.2g} m, "
            "which needs few rays here"
        )
    wanted = sampling.footprint_spacing
    if spacings.diffuse > 1.5 * wanted:
        yield (
            f"diffuse_ray_spacing = {spacings.diffuse:g} m is coarser than a resolution cell: edges of shadows become "
            f"ragged; set it to {wanted:.3g} m or less"
        )


def check_small_parts(sampling: SamplingPlan, shortfalls: Sequence[Shortfall]) -> list[str]:
    """Warn of surface that is too coarsely sampled because of the bound on rays; returns the warnings' texts.

    Corners of metal facets that lack rays give a note without a warning: two lattices share a part of their error, so
    that the stated sampling error may be several dB too low, and the note says so.
    """
    notes = (
        [_coarse_corners(sampling, max(corners, key=lambda s: s.share))]
        if (corners := [s for s in shortfalls if s.corners])
        else []
    )
    notes += [_coarse_chains(sampling, s) for s in shortfalls if s.chains][:1]
    worst = max(shortfalls, key=lambda s: s.bias_db, default=None)
    if worst is None or worst.share < SMALL_SHARE or worst.bias_db < SMALL_BIAS_DB:
        return notes
    text = (
        f"{sampling.scene.name}: {100 * worst.share:.0f} % of the surface is too small or too curved for the rays that "
        f"fit the bound on rays, {worst.spacing:.3g} m apart: its coherent return is up to {worst.bias_db:.0f} "
        f"dB too strong; set ray_spacing to {worst.needed:.2g} m, or make the image smaller"
    )
    warnings.warn(text, SarmitsubaWarning, stacklevel=4)
    return [text, *notes]


def _coarse_chains(sampling: SamplingPlan, short: Shortfall) -> str:
    return (
        f"{sampling.scene.name}: curved or small surfaces that rays meet after a reflection are too large for the "
        f"bound on rays: tubes there are {short.spacing:.3g} m wide; set ray_spacing to {short.needed:.2g} m, or "
        "make the image smaller"
    )


def _coarse_corners(sampling: SamplingPlan, short: Shortfall) -> str:
    wavelength = sampling.scene.radar.waveform.wavelength
    return (
        f"{sampling.scene.name}: metal facets at right angles ({100 * short.share:.2g} % of the surface) are too large "
        f"for the bound on rays: their double bounces, with rays {short.spacing / wavelength:.1f} wavelengths apart, "
        f"may be several dB off, more than the stated sampling error says; set ray_spacing to {short.needed:.2g} m, or "
        "make the image smaller"
    )
