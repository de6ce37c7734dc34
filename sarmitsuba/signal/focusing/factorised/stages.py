"""Stages of factorised backprojection from range-compressed pulses to pixels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import TypeAlias

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F32, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.progress import Progress
from sarmitsuba.machine.backend import arrays, device_array, dr
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.backprojection_kernel import AXES_STRIDE, Weighting
from sarmitsuba.signal.focusing.factorised.division import Plan, Section, SubimageLevel
from sarmitsuba.signal.focusing.factorised.image_weights import axes_table, pulse_weights, weighting_of
from sarmitsuba.signal.focusing.factorised.kernels import form, merge
from sarmitsuba.signal.focusing.factorised.polar_lanes import ANGLES, GroupPulses, PolarAxes, quads
from sarmitsuba.signal.focusing.factorised.resampling import Pixels, interpolate_rows, resample
from sarmitsuba.signal.focusing.factorised.sampling import CORRECTION, SubimageSampling, correction
from sarmitsuba.signal.focusing.profiles import MOST_BEYOND, ProfilePlan
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import RawData

# bytes of profiles at a time
BATCH_BYTES = 32 << 20
# copies while they are made: spectrum, padded spectrum, transform, cut-out, table and the device's copy
_COPIES = 6
# pixels per launch
TILE_PIXELS = 1 << 22


Merger: TypeAlias = (
    "tuple[tuple[PolarAxes, SubimageLevel], tuple[PolarAxes, SubimageLevel], "
    "dr.ArrayBase, dr.ArrayBase, dr.ArrayBase, float]"
)


@dataclass(frozen=True, eq=False)
class Job:
    """Data common to all stages.

    Parameters
    ----------
    types : Dr.Jit's array types
    raw : range-compressed data, some layers of them
    profiles : how they become profiles
    pulse_weights : (n_pulses,) of the azimuth window; ones where each pixel has its own band
    weighting : antenna and bands
    reference : m, range whose spreading loss is divided out
    sampling : of subimages
    """

    types: ModuleType
    raw: RawData
    profiles: ProfilePlan
    pulse_weights: F64
    weighting: Weighting
    reference: float
    sampling: SubimageSampling

    @property
    def turns_per_metre(self) -> dr.ArrayBase:
        """Of the carrier's phase, 2 fc / c."""
        return dr.opaque(self.types.Float64, 2.0 * self.raw.radar.waveform.center_frequency / SPEED_OF_LIGHT)


def run_plan(job: Job, plan: Plan, grid: ImageGrid, progress: Progress) -> C64:
    """Pixels (n_layers, n_azimuth, n_range): sums over all pulses before division by the summed weights."""
    types, n_layers = job.types, len(job.raw.layers)
    image = np.empty((n_layers, *grid.shape), dtype=np.complex64)
    tiles = list(image_tiles(grid))
    states = [
        [dr.zeros(types.Float32, (rows.stop - rows.start) * grid.shape[1]) for _ in range(2 * n_layers)]
        for rows in tiles
    ]
    dr.make_opaque(states)
    work = float(image.size) * job.raw.radar.track.n_pulses
    for i, section in enumerate(plan.sections):
        polar, words = _correct_kernel(job, section, _subimage(job, section))
        for rows, state in zip(tiles, states, strict=True):
            if rows.start < section.rows.stop and section.rows.start < rows.stop:
                lanes = (rows.stop - rows.start) * grid.shape[1]
                kernel = job.profiles.kernel
                pixels, images = tile_pixels(types, section, grid, rows), words
                if section.on_rows:
                    samples = (rows.stop - rows.start) * section.n_ranges
                    images = interpolate_rows(types, polar, pixels, samples, kernel, words)
                state[:] = resample(
                    types,
                    polar,
                    pixels,
                    lanes,
                    job.turns_per_metre,
                    kernel,
                    images,
                    state,
                    job.sampling.upsampling if section.on_rows else 0.0,
                )
                dr.eval(state)
        dr.sync_thread()
        progress("focus", work * (i + 1) / len(plan.sections), work, {})
    for rows, state in zip(tiles, states, strict=True):
        for layer in range(n_layers):
            target = image[layer, rows].reshape(-1)
            target.real, target.imag = state[2 * layer].numpy(), state[2 * layer + 1].numpy()
    return image


def image_tiles(grid: ImageGrid) -> Iterator[slice]:
    """Rows of the image of each launch."""
    step = max(1, TILE_PIXELS // grid.shape[1])
    for start in range(0, grid.shape[0], step):
        yield slice(start, min(start + step, grid.shape[0]))


def group_centers(section: Section, level: SubimageLevel, antenna: F64) -> F64:
    """Mean antenna position (n_groups, 3) of a level's groups in the section's frame; zero for groups of padding."""
    if level.n_groups == 1:
        return np.zeros((1, 3))
    starts = np.arange(0, section.n_pulses, level.n_pulses)
    means = np.add.reduceat(antenna, starts, axis=0) / np.diff(np.append(starts, section.n_pulses))[:, None]
    out = np.zeros((level.n_groups, 3))
    out[: len(means)] = means
    return out


def _subimage(job: Job, section: Section) -> list[dr.ArrayBase]:
    """The section's subimage, words [angle, range] per layer."""
    antenna, centers = antenna_and_centers(job, section)
    images = _finest(job, section, antenna, centers[0])
    for step in range(len(section.levels) - 1):
        images = merge(job.types, *merger(job, section, centers, step), images)
    return images


def antenna_and_centers(job: Job, section: Section) -> tuple[F64, list[F64]]:
    """Antenna positions (n_pulses, 3) of a section, and each level's groups' mean positions, in the section's frame."""
    span = slice(section.first, section.first + section.n_pulses)
    antenna = section.local(job.raw.radar.track.position[span])
    return antenna, [group_centers(section, level, antenna) for level in section.levels]


def merger(job: Job, section: Section, centers: list[F64], step: int) -> Merger:
    """Parameters of :func:`.kernels.merge` from a level to the next, images left out."""
    low, high = section.levels[step : step + 2]
    shift = centers[step] - np.repeat(centers[step + 1], low.n_groups // high.n_groups, axis=0)
    return (
        (PolarAxes.of(job.types, section, low), low),
        (PolarAxes.of(job.types, section, high), high),
        quads(job.types, shift, squares=True),
        quads(job.types, centers[step + 1], squares=False),
        job.turns_per_metre,
        job.sampling.upsampling,
    )


def _finest(job: Job, section: Section, antenna: F64, centers: F64) -> list[dr.ArrayBase]:
    """The finest subimages, from pulses in batches of whole groups."""
    types, level, n_layers = job.types, section.levels[0], len(job.raw.layers)
    polar = PolarAxes.of(types, section, level)
    size = level.n_groups * level.n_angles * section.n_ranges
    out = [dr.zeros(types.UInt64, size) for _ in range(n_layers)]
    dr.make_opaque(out)
    for groups in group_batches(job, section, n_layers):
        n = groups.stop - groups.start
        form(
            types,
            polar,
            n * (level.n_angles // ANGLES),
            quads(types, centers[groups], squares=False),
            group_pulses(job, section, antenna, centers, groups, job.raw.data),
            job.profiles.kernel,
            n_layers,
            job.weighting,
            out,
            dr.opaque(types.UInt32, groups.start),
            section.n_ranges,
        )
        dr.eval(out)
        dr.sync_thread()
    return out


def group_batches(job: Job, section: Section, n_layers: int) -> Iterator[slice]:
    """Groups of a section whose profiles are in memory together."""
    level = section.levels[0]
    used = -(-section.n_pulses // level.n_pulses)
    step = max(1, BATCH_BYTES // (8 * n_layers * level.n_pulses * job.profiles.n_stored))
    for start in range(0, used, step):
        yield slice(start, min(start + step, used))


def own_pulses(section: Section, groups: slice) -> slice:
    """Pulses of the radar in selected groups."""
    length = section.levels[0].n_pulses
    stop = min(groups.stop * length, section.n_pulses)
    return slice(section.first + groups.start * length, section.first + stop)


def group_pulses(
    job: Job, section: Section, antenna: F64, centers: F64, groups: slice, data: C64 | None
) -> GroupPulses:
    """Tables of the pulses of selected groups; padding pulses at the section's end have weight zero.

    With the profiles of data (n_layers, n_pulses, n_samples); without any where ``data`` is None.
    """
    types, plan, radar = job.types, job.profiles, job.raw.radar
    length = section.levels[0].n_pulses
    first, stop = groups.start * length, min(groups.stop * length, section.n_pulses)
    n, padded = stop - first, (groups.stop - groups.start) * length
    own = own_pulses(section, groups)
    shift = np.zeros((padded, 3))
    shift[:n] = antenna[first:stop] - centers[np.arange(first, stop) // length]
    starts = np.zeros(padded)
    starts[:n] = radar.window.start_range[own] / plan.step - MOST_BEYOND * plan.oversampling
    axes = np.zeros((padded, AXES_STRIDE), dtype=np.float32)
    axes[:n] = axes_table(radar, job.pulse_weights, own, section.axes)
    axes[n:, 7] = 1.0
    stored = plan.n_stored + 2 * MOST_BEYOND * plan.oversampling
    profiles = np.zeros((0 if data is None else len(data), padded, stored), dtype=np.complex64)
    if data is not None:
        profiles[:, :n] = plan.profiles(data[:, own], MOST_BEYOND)
    Float64, UInt32 = types.Float64, types.UInt32
    return GroupPulses(
        n_pulses=dr.opaque(UInt32, length),
        shifts=quads(types, shift, squares=True),
        starts=device_array(Float64, starts),
        axes=device_array(types.Float32, axes),
        profiles=device_array(types.UInt64, profiles.view(np.uint64)),
        n_stored=dr.opaque(UInt32, stored),
        n_plane=dr.opaque(UInt32, padded * stored),
        last=dr.opaque(types.Int32, stored - plan.width),
        per_metre=dr.opaque(Float64, 1.0 / plan.step),
        turns_per_metre=job.turns_per_metre,
        inverse_square=dr.opaque(Float64, 1.0 / job.reference**2),
    )


def _correct_kernel(
    job: Job, section: Section, images: list[dr.ArrayBase]
) -> tuple[PolarAxes, list[dr.ArrayBase]]:
    """The section's subimage with the gridding kernel's transform divided out, in angle and where needed in range."""
    level = section.levels[-1]
    shape, sizes, factors = corrections(job, section)
    out = []
    for image in images:
        if section.on_rows:
            words = image.numpy().view(np.complex64).reshape(shape)
            spectrum = scipy.fft.fft(words, n=sizes[0], axis=0, workers=-1)
            spectrum *= factors[0][:, None]
            fine = scipy.fft.ifft(spectrum, axis=0, overwrite_x=True, workers=-1)[: shape[0]]
            out.append(device_array(job.types.UInt64, np.ascontiguousarray(fine).view(np.uint64)))
            continue
        spectrum = scipy.fft.fft2(image.numpy().view(np.complex64).reshape(shape), s=sizes, workers=-1)
        spectrum *= factors[0][:, None]
        spectrum *= factors[1]
        fine = scipy.fft.ifft2(spectrum, overwrite_x=True, workers=-1)[: shape[0], : shape[1]]
        out.append(device_array(job.types.UInt64, np.ascontiguousarray(fine).view(np.uint64)))
    return PolarAxes.of(job.types, section, level), out


def corrections(job: Job, section: Section) -> tuple[tuple[int, int], list[int], list[F32]]:
    """Shape of the section's subimage, lengths of the transforms along both axes, and factors of their frequencies."""
    shape = (section.levels[-1].n_angles, section.n_ranges)
    sizes = [int(scipy.fft.next_fast_len(n + CORRECTION)) for n in shape]
    return shape, sizes, [correction(job.sampling, n) for n in sizes]


def tile_pixels(types: ModuleType, section: Section, grid: ImageGrid, rows: slice) -> Pixels:
    """Rows of the image in the section's frame."""
    base = grid.origin * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, grid.height])
    corner = section.local(base + grid.azimuth[rows.start] * grid.along)
    vectors = (corner, section.axes @ grid.along * grid.azimuth_spacing, section.axes @ grid.across)
    x, y, z = (tuple(dr.opaque(types.Float64, float(v)) for v in vector) for vector in vectors)
    return Pixels(
        dr.opaque(types.UInt32, grid.shape[1]),
        dr.opaque(types.Float64, 1.0 / grid.shape[1]),
        x,
        y,
        z,
        device_array(types.Float64, grid.across_distance()),
    )


def plan_bytes(plan: Plan, profiles: ProfilePlan, grid: ImageGrid, n_layers: int) -> int:
    """Peak memory in bytes beyond raw data and image: profiles of a batch, subimages, sums and a launch's pixels."""
    group = 8 * n_layers * profiles.n_stored * max(section.levels[0].n_pulses for section in plan.sections)
    pixels = int(np.prod(grid.shape))
    # a launch's pixels: sums before and after, and the subimage on their rows
    launch = (16 + 24 * n_layers) * min(pixels, TILE_PIXELS)
    return _COPIES * max(group, BATCH_BYTES) + n_layers * (plan.n_bytes + 8 * pixels) + launch


def image_reference(radar: Radar, grid: ImageGrid) -> float:
    """Range of the image's middle from the middle of the track, m, whose spreading loss is divided out."""
    middle = grid.positions_on_line(grid.shape[0] // 2)[grid.shape[1] // 2]
    return float(np.linalg.norm(middle - radar.track.center_position))


def make_job(raw: RawData, profiles: ProfilePlan, plan: Plan, window: Window, grid: ImageGrid) -> Job:
    """Data common to all stages, from raw data and plan."""
    types, radar = arrays(), raw.radar
    return Job(
        types,
        raw,
        profiles,
        pulse_weights(radar, window),
        weighting_of(types, radar, window),
        image_reference(radar, grid),
        plan.sampling,
    )
