"""Sampling requirements of moving shapes: lit area, range rates, block length."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64, box_corners, unit_rows
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.motion import Motion
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.block import BlockPlan, plan_block

# times of a sector at which positions of moving shapes are evaluated
TIMES = 9
# rad, allowed rms phase error of a moving shape over a block: -26 dB of its own echo
MOTION_PHASE = 0.05
# allowed change of the gain from a block's middle to its end where something moves, relative to the peak gain
BEAM_CHANGE = 0.03
# shortest blocks, see `sarmitsuba.simulation.execution.blocks.SHORTEST`
SHORTEST = 8


def swept(scene: Scene, pulses: tuple[int, int]) -> list[F64]:
    """Boxes swept by each moving mesh in a sector of the track: corners (TIMES, 8, 3), m, scene frame."""
    geometry, time = scene.geometry, scene.radar.track.time
    times = np.linspace(time[pulses[0]], time[pulses[1] - 1], TIMES)
    out = []
    for motion, faces in geometry.moving_meshes():
        vertices = geometry.vertices[geometry.faces[faces]].reshape(-1, 3)
        corners = box_corners(np.stack([vertices.min(axis=0), vertices.max(axis=0)]))
        out.append(corners + motion.displacement(times)[:, None])
    return out


def find_lit_boxes(scene: Scene, pulses: tuple[int, int], low: F64, high: F64, middle: F64, axes: F64) -> F64:
    """Boxes to be lit for moving meshes that appear in a given box of the image.

    A mesh appears at its position or displaced by its range rate, :math:`-R v_r / v` along the track, so that a train
    outside the image may appear in it.

    Parameters
    ----------
    scene, pulses : the sector of the track
    low, high : (3,) m, box along the rows of ``axes`` (along, across, up) about ``middle``

    Returns
    -------
    (n, 3) corners in the same axes; none where no mesh moves
    """
    found = [np.zeros((0, 3))]
    radar = scene.radar
    times = np.linspace(radar.track.time[pulses[0]], radar.track.time[pulses[1] - 1], TIMES)
    for corners, (motion, _) in zip(swept(scene, pulses), scene.geometry.moving_meshes(), strict=True):
        local = (corners - middle) @ axes.T
        velocity, places = motion.velocity_at(times)[:, None], [local]
        for kept in (
            np.ones(3),
            np.array([1.0, 1.0, 0.0]),
        ):  # for paths over the ground a vertical velocity cancels
            seen = local.copy()
            seen[..., 0] += azimuth_shift(radar, corners, velocity * kept, times)
            places.append(seen)
        every = np.concatenate(places)[..., :2].reshape(-1, 2)
        if (every.min(axis=0) <= high[:2]).all() and (every.max(axis=0) >= low[:2]).all():
            found.append(local.reshape(-1, 3))
    return np.concatenate(found)


def azimuth_shift(radar: Radar, points: F64, velocity: F64, times: F64) -> F64:
    r"""Azimuth displacement of a moving point in the image by its range rate, :math:`-R v_r / v`, m.

    Parameters
    ----------
    points, velocity : (n, ..., 3) m and m/s, scene frame, at ``times`` (n,) s
    """
    track = radar.track
    antenna = np.stack([np.interp(times, track.time, track.position[:, i]) for i in range(3)], axis=-1)
    leg = points - antenna.reshape(-1, *(1,) * (points.ndim - 2), 3)
    speed = float(np.linalg.norm(track.velocity[track.center_index]))
    return np.asarray(-np.sum(leg * velocity, axis=-1) / max(speed, 1e-9))


def describe_vanished(scene: Scene) -> str:
    """Meshes that stand in the image and appear outside of it, displaced by their range rate, as a note; else empty."""
    radar, image = scene.radar, scene.image
    pulses = radar.track.center_index, radar.track.center_index + 1
    middle, half = np.array([image.center_x, image.center_y, image.height]), 0.5 * image.extent_azimuth
    time, names, most = radar.track.time[slice(*pulses)], [], 0.0
    for corners, (motion, faces) in zip(swept(scene, pulses), scene.geometry.moving_meshes(), strict=True):
        along = (corners - middle) @ radar.track.along
        seen = along[:1] + azimuth_shift(radar, corners[:1], motion.velocity_at(time)[:, None], time)
        if np.abs(along).min() <= half and (seen.min() > half or seen.max() < -half):
            names.append(scene.geometry.mesh_names[scene.geometry.face_mesh[faces.start]])
            most = max(most, float(np.abs(seen).max()))
    if not names:
        return ""
    return (
        f"{scene.name}: {', '.join(names[:3])}{' and others' if names[3:] else ''}: the range rate displaces the echo "
        f"by up to {most:.4g} m along the track, out of the image; set image_extent_azimuth to {2.1 * most:.3g} m"
    )


def fastest(scene: Scene) -> float:
    """Largest speed of a mesh during the aperture, m/s: bound on its change of range rates."""
    time = scene.radar.track.time[[0, -1]]
    speeds = [np.linalg.norm(m.velocity_at(time), axis=1).max() for m, _ in scene.geometry.moving_meshes()]
    return float(max(speeds, default=0.0))


def block_length(scene: Scene, reference: F64, box: F64, length: int, extra_slant_range: float) -> int:
    """Largest block length up to ``length`` for moving shapes; 1 where no blocks are possible.

    Range rates are exact at the key pulse. The remaining errors over a block are the acceleration (of the shape, and of
    its range relative to a shape at rest there), and the antenna gain, which is that of the key pulse.

    Parameters
    ----------
    scene : with its radar
    reference, box, extra_slant_range : as for :func:`sarmitsuba.signal.block.plan_block`
    length : upper bound from other criteria
    """
    radar, n = scene.radar, scene.radar.track.n_pulses
    meshes = [
        (scene.geometry.vertices[scene.geometry.faces[faces]].mean(axis=(0, 1)), motion)
        for motion, faces in scene.geometry.moving_meshes()
    ]
    while meshes and length > 1:
        starts = sorted({0, max(0, (n - length) // 2), max(0, n - length)})
        if beam_change(radar, reference, length) <= BEAM_CHANGE and all(
            _phase_error(plan, radar, point, motion) <= MOTION_PHASE
            for start in starts
            for plan in [
                plan_block(
                    radar, start, min(start + length, n), reference, box, extra_slant_range=extra_slant_range
                )
            ]
            for point, motion in meshes
        ):
            return length
        length = int(length / np.sqrt(2.0))
        length = length if length >= SHORTEST else 1
    return length


def _phase_error(plan: BlockPlan, radar: Radar, point: F64, motion: Motion) -> float:
    """Rms difference over a block between the exact phase of a moving point and the synthesised phase, rad."""
    track = radar.track
    pulses = slice(plan.start, plan.stop)
    place = point + motion.displacement(track.time[pulses])
    key = plan.key - plan.start
    exact = radar.slant_range(place, pulses) - radar.slant_range(plan.reference, pulses)
    at_key = replace(plan.state, velocity=plan.state.velocity - motion.velocity_at(track.time[plan.key]))
    rate = at_key.rate(place[key]) - plan.reference_rate
    offset = exact[key : key + 1]
    bend = plan.curvature.of_range(offset)[:, 0] + plan.curvature.of_range_rate(np.array([rate]))[:, 0]
    left = exact - offset - rate * plan.tau - bend
    return float(4.0 * np.pi / radar.waveform.wavelength * np.std(left))


def beam_change(radar: Radar, point: F64, length: int) -> float:
    """Largest change of the two-way gain towards a point over half a block, relative to its peak over the track."""
    pointing, leg = radar.pointing, point - radar.track.position
    u = unit_rows(leg)
    gain = radar.antenna.two_way_amplitude(
        np.sum(u * pointing.azimuth_axis, axis=1), np.sum(u * pointing.elevation_axis, axis=1)
    )
    half = max(1, min(length // 2, gain.size - 1))
    peak = float(gain.max())
    return float(np.abs(gain[half:] - gain[:-half]).max()) / peak if gain.size > 1 and peak > 0.0 else 0.0
