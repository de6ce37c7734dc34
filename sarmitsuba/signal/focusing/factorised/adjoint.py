"""Adjoint of factorised backprojection, from pixels to range-compressed pulses, with its compiled steps.

Subimages and profiles to which is added are pairs of float64 arrays, real and imaginary part, one pair a layer.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.progress import Progress
from sarmitsuba.machine.backend import device_array, dr
from sarmitsuba.signal.focusing.backprojection_kernel import Weighting, scale_complex, times, weighted_sum
from sarmitsuba.signal.focusing.factorised.division import Plan, Section, SubimageLevel
from sarmitsuba.signal.focusing.factorised.polar_lanes import (
    ANGLES,
    FormLanes,
    GroupPulses,
    MergeLanes,
    PolarAxes,
    quads,
)
from sarmitsuba.signal.focusing.factorised.resampling import add, adjoint_along_rows, adjoint_resample
from sarmitsuba.signal.focusing.factorised.sampling import TAPS, refinement_weights
from sarmitsuba.signal.focusing.factorised.stages import (
    Job,
    antenna_and_centers,
    corrections,
    group_batches,
    group_pulses,
    image_tiles,
    merger,
    own_pulses,
    tile_pixels,
)
from sarmitsuba.signal.focusing.profiles import MOST_BEYOND
from sarmitsuba.signal.gridding import GriddingKernel
from sarmitsuba.signal.image import ImageGrid

if TYPE_CHECKING:
    Complex = tuple[dr.ArrayBase, dr.ArrayBase]


def _read(types: ModuleType, image: Complex, index: dr.ArrayBase, inside: dr.ArrayBase) -> Complex:
    """Sample of a subimage in single precision; zero in lanes that do not count."""
    re, im = (types.Float32(dr.gather(types.Float64, part, index, inside)) for part in image)
    return re, im


def adjoint_form(
    types: ModuleType,
    polar: PolarAxes,
    n_lines: int,
    centers: dr.ArrayBase,
    pulses: GroupPulses,
    kernel: GriddingKernel,
    weighting: Weighting,
    images: list[Complex],
    first: dr.ArrayBase,
    n_ranges: int,
    out: list[Complex],
) -> None:
    """Adjoint of :func:`sarmitsuba.signal.focusing.factorised.kernels.form`: add subimages to the profiles of a batch.

    Parameters
    ----------
    types, polar, n_lines, centers, pulses, kernel, weighting, first, n_ranges : as for ``form``
    images : subimages [group, angle, range]
    out : profiles [pulse, sample]
    """
    lanes = FormLanes.of(types, polar, n_lines, centers, first, n_ranges)
    values = [
        [_read(types, image, lanes.place + k * polar.n_ranges, lanes.inside) for image in images]
        for k in range(ANGLES)
    ]

    def body(t: dr.ArrayBase) -> tuple[dr.ArrayBase]:
        seen = pulses.seen_from(types, lanes.group, t, lanes.points, weighting, kernel)
        for layers, (factor, taps, index) in zip(values, seen, strict=True):
            for value, target in zip(layers, out, strict=True):
                turned = times((factor[0], -factor[1]), value)
                for i, tap in enumerate(taps):
                    add(types, target, scale_complex(tap, turned), index + i, lanes.inside)
        return (t + 1,)

    start = dr.zeros(types.UInt32, lanes.size)
    dr.while_loop(state=(start,), cond=lambda t: t < pulses.n_pulses, body=body, mode="symbolic")
    dr.eval(out)


def adjoint_merge(
    types: ModuleType,
    below: tuple[PolarAxes, SubimageLevel],
    above: tuple[PolarAxes, SubimageLevel],
    shifts: dr.ArrayBase,
    centers: dr.ArrayBase,
    turns_per_metre: dr.ArrayBase,
    upsampling: float,
    images: list[Complex],
) -> list[Complex]:
    """Adjoint of :func:`sarmitsuba.signal.focusing.factorised.kernels.merge`: narrower subimages from wider ones."""
    low, level = below
    n_ranges = len(images[0][0]) // (above[1].n_groups * above[1].n_angles)
    ratio = level.ratio
    lanes = MergeLanes.of(types, below, above, centers, n_ranges)
    weights = refinement_weights(upsampling, ratio)
    size = level.n_groups * level.n_angles * n_ranges
    out = [(dr.zeros(types.Float64, size), dr.zeros(types.Float64, size)) for _ in images]
    dr.make_opaque(out)
    values = [
        [_read(types, image, lanes.place + j * lanes.stride, lanes.inside) for j in range(ratio)]
        for image in images
    ]

    def body(c: dr.ArrayBase) -> tuple[dr.ArrayBase]:
        phasors, index = lanes.child(types, c, shifts, turns_per_metre)
        for angles, target in zip(values, out, strict=True):
            turned = [times((p[0], -p[1]), value) for p, value in zip(phasors, angles, strict=True)]
            for k in range(TAPS):
                # the second half of the angles has the weights of the first, mirrored
                taps = [weights[j][k] for j in range(ratio // 2)]
                taps += [weights[j][TAPS - 1 - k] for j in reversed(range(ratio // 2))]
                add(types, target, weighted_sum(taps, turned), index + k * low.n_ranges, lanes.inside)
        return (c + 1,)

    start = dr.zeros(types.UInt32, lanes.size)
    dr.while_loop(state=(start,), cond=lambda c: c < lanes.merged, body=body, mode="symbolic")
    dr.eval(out)
    return out


def adjoint_plan(job: Job, plan: Plan, grid: ImageGrid, pixels: C64, progress: Progress) -> C64:
    """Adjoint of :func:`sarmitsuba.signal.focusing.factorised.stages.run_plan` as a function of the job's data.

    Parameters
    ----------
    job : whose data are not read
    pixels : (n_layers, n_azimuth, n_range) complex64

    Returns
    -------
    (n_layers, n_pulses, n_samples) complex64
    """
    data = np.zeros((len(pixels), *job.raw.data.shape[1:]), dtype=np.complex64)
    work = float(pixels.size) * job.raw.radar.track.n_pulses
    for i, section in enumerate(plan.sections):
        images = _correct_adjoint(job, section, _subimage(job, section, grid, pixels))
        antenna, centers = antenna_and_centers(job, section)
        for step in reversed(range(len(section.levels) - 1)):
            images = adjoint_merge(job.types, *merger(job, section, centers, step), images)
        level = section.levels[0]
        for groups in group_batches(job, section, 2 * len(pixels)):
            table = group_pulses(job, section, antenna, centers[0], groups, None)
            n = groups.stop - groups.start
            stored = job.profiles.n_stored + 2 * MOST_BEYOND * job.profiles.oversampling
            out = _zeros(job, len(pixels), n * level.n_pulses * stored)
            adjoint_form(
                job.types,
                PolarAxes.of(job.types, section, level),
                n * (level.n_angles // ANGLES),
                quads(job.types, centers[0][groups], squares=False),
                table,
                job.profiles.kernel,
                job.weighting,
                images,
                dr.opaque(job.types.UInt32, groups.start),
                section.n_ranges,
                out,
            )
            dr.sync_thread()
            own = own_pulses(section, groups)
            profiles = np.array([_single(pair).reshape(-1, stored) for pair in out])
            data[:, own] = job.profiles.adjoint_profiles(profiles[:, : own.stop - own.start], MOST_BEYOND)
        progress("adjoint", work * (i + 1) / len(plan.sections), work, {})
    return data


def _zeros(job: Job, n_layers: int, size: int) -> list[Complex]:
    """Pairs of float64 arrays for sums, one a layer."""
    out = [(dr.zeros(job.types.Float64, size), dr.zeros(job.types.Float64, size)) for _ in range(n_layers)]
    dr.make_opaque(out)
    return out


def _single(pair: Complex) -> C64:
    """A pair as complex64."""
    return np.asarray(pair[0].numpy() + 1j * pair[1].numpy(), dtype=np.complex64)


def _subimage(job: Job, section: Section, grid: ImageGrid, pixels: C64) -> list[Complex]:
    """Adjoint of the last interpolation: the section's subimage from pixels."""
    types, n_layers = job.types, len(pixels)
    polar = PolarAxes.of(types, section, section.levels[-1])
    out = _zeros(job, n_layers, section.levels[-1].n_angles * section.n_ranges)
    kernel = job.profiles.kernel
    for rows in image_tiles(grid):
        if not (rows.start < section.rows.stop and section.rows.start < rows.stop):
            continue
        values = [
            tuple(device_array(types.Float32, np.ascontiguousarray(part)) for part in (p.real, p.imag))
            for p in pixels[:, rows]
        ]
        lanes = (rows.stop - rows.start) * grid.shape[1]
        where = tile_pixels(types, section, grid, rows)
        samples = (rows.stop - rows.start) * section.n_ranges
        target = _zeros(job, n_layers, samples) if section.on_rows else out
        upsampling = job.sampling.upsampling if section.on_rows else 0.0
        turns = job.turns_per_metre
        adjoint_resample(types, polar, where, lanes, turns, kernel, values, target, upsampling)
        if section.on_rows:
            adjoint_along_rows(types, polar, where, samples, kernel, target, out)
    return out


def _correct_adjoint(job: Job, section: Section, images: list[Complex]) -> list[Complex]:
    """Adjoint of the division by the gridding kernel's transform."""
    shape, sizes, factors = corrections(job, section)
    out = []
    for image in images:
        words = _single(image).reshape(shape)
        axes = (0,) if section.on_rows else (0, 1)
        lengths = [sizes[axis] for axis in axes]
        spectrum = scipy.fft.fftn(words, s=lengths, axes=axes, workers=-1, norm="forward")
        spectrum *= factors[0][:, None]
        if not section.on_rows:
            spectrum *= factors[1]
        fine = scipy.fft.ifftn(spectrum, axes=axes, workers=-1, overwrite_x=True, norm="forward")
        fine = fine[: shape[0], : shape[1]].astype(np.complex128)
        out.append(
            (
                device_array(job.types.Float64, np.ascontiguousarray(fine.real)),
                device_array(job.types.Float64, np.ascontiguousarray(fine.imag)),
            )
        )
    return out
