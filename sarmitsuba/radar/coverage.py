"""Coverage of the scene by image and beam, and ambiguities."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.swath import Box, beam_bandwidth, doppler_bandwidth

_MOST_AMBIGUITIES = 10_000.0  # most orders of ambiguities that are summed
_SMALL_SHARE = 0.005  # smallest energy share of ghosts that is reported


def check_coverage(radar: Radar, scene: Box, box: Box, where: str, film_where: str) -> Box:
    """Raise a RadarError when image and geometry, or beam and geometry, do not overlap.

    Parameters
    ----------
    radar : with track, antenna and pointing
    scene, box : bounds of the geometry and of the image, in the same axes
    where, film_where : start of an error about the sensor, about the film

    Returns
    -------
    the part of the scene that the image holds
    """
    drop = float(radar.track.center_position[2] - box.origin[2])
    reach = max(float(-scene.local(radar.track.center_position[None])[0, 1]), 1e-9)
    layover = max(0.0, float(scene.high[2])) * max(drop, 0.0) / reach
    shared = box.overlap(scene.low - np.array([0.0, layover, 0.0]), scene.high)
    if shared is None:
        raise RadarError(
            f"{film_where}: the image covers {_span(box, 0)} along and {_span(box, 1)} across the "
            f"track from the aim point, the scene {_span(scene, 0)} and {_span(scene, 1)}: they do not overlap; "
            "move the aim point or image_center_x, image_center_y"
        )
    seen = replace(box, low=shared[0], high=shared[1])
    if not radar.antenna.directive:
        return seen
    points = seen.samples() @ seen.axes + seen.origin
    pick = np.unique(np.linspace(0, radar.track.n_pulses - 1, 65).astype(int))
    line = points[None] - radar.track.position[pick][:, None]
    line /= np.linalg.norm(line, axis=2, keepdims=True)
    ahead = np.einsum("npc,nc->np", line, radar.pointing.boresight[pick]) > 0.0
    inside = ahead.any(axis=1)
    worst = []
    axes = (radar.pointing.azimuth_axis, radar.pointing.elevation_axis)
    for axis, null in zip(axes, radar.antenna.nulls, strict=True):
        sine = np.einsum("npc,nc->np", line, axis[pick])
        inside &= (sine.min(axis=1) < null) & (sine.max(axis=1) > -null)
        gap = np.maximum(np.maximum(sine.min(axis=1), -sine.max(axis=1)), 0.0)
        worst.append(float(np.degrees(np.arcsin(np.clip(gap.min(), 0.0, 1.0)))))
    if not inside.any():
        raise RadarError(
            f"{where}: the scene is outside the beam, {worst[0]:.3g} deg off in azimuth and "
            f"{worst[1]:.3g} deg in elevation (half-power widths "
            f"{np.degrees(radar.antenna.azimuth_beamwidth):.3g} deg and "
            f"{np.degrees(radar.antenna.elevation_beamwidth):.3g} deg); aim at it or widen the beam"
        )
    return seen


def ambiguities(radar: Radar, seen: Box, image: Box, where: str, *, derived: bool) -> list[str]:
    """Warnings about Doppler and range ambiguity, one line each.

    Parameters
    ----------
    radar : complete
    seen : part of the scene in the image, which can appear as a ghost anywhere in the image
    image : the image's box, in the same axes
    where : start of every line
    derived : prf computed from the number of pulses and the resolution
    """
    track = radar.track
    if track.n_pulses < 2:
        return []
    notes = []
    prf = track.prf
    pick = np.unique(np.linspace(0, track.n_pulses - 1, 33).astype(int))
    position, velocity = track.position[pick], track.velocity[pick]
    lam = radar.waveform.wavelength
    speed = float(np.linalg.norm(velocity, axis=1).max())
    own = np.isfinite(radar.half_aperture)  # the track is longer than any pixel's aperture
    at_once = own or radar.mode_law.instantaneous_doppler or not track.is_straight
    reach = _reach(seen, image)
    beam = beam_bandwidth(radar.antenna, speed, lam, radar.half_aperture)
    spread = doppler_bandwidth(position, velocity, reach, lam, instantaneous=True)
    width = float(reach.high[0] - reach.low[0])
    apart = prf / max(spread, 1e-30) * width
    needed = doppler_bandwidth(position, velocity, seen, lam, instantaneous=at_once)
    if own:
        used = 0.0 if radar.mode_law.instantaneous_doppler else 4.0 * speed / lam * radar.half_turn
        share = _share_by_beam(radar, prf * lam / (2.0 * speed), width / max(apart, 1e-30))
        # the beam attenuates the ghosts: where none are left, only the pixels' own band has to be sampled
        needed = needed + used if share >= _SMALL_SHARE else used
    else:
        share = _share_by_place(seen, image, apart)
    if share >= _SMALL_SHARE:
        needed = max(needed, spread)
    needed = min(needed, beam)
    if prf < needed * (1.0 - 1e-9):
        ghosts = (
            f": azimuth ghosts {apart:.4g} m apart will hold about {100.0 * share:.0f} % of the image's energy"
            if share >= _SMALL_SHARE
            else ""
        )
        remedy = (
            "raise n_pulses or coarsen azimuth_resolution" if derived else f"raise prf to {needed:.4g} Hz"
        )
        notes.append(
            f"{where}: prf = {prf:.6g} Hz is below the Doppler bandwidth {needed:.6g} Hz of the image{ghosts}; "
            f"{remedy}, or narrow the beam"
        )
    length = radar.window.extent + SPEED_OF_LIGHT * radar.waveform.pulse_width / 2.0
    if length > SPEED_OF_LIGHT / (2.0 * prf):
        notes.append(
            f"{where}: the echoes of one pulse last {length:.6g} m in range, longer than the "
            f"unambiguous range {SPEED_OF_LIGHT / (2.0 * prf):.6g} m at prf = {prf:.6g} Hz; lower prf, speed "
            "or pulse_width"
        )
    return notes


def _reach(seen: Box, image: Box) -> Box:
    """Box whose azimuth length is the largest distance between a pixel and its possible ghosts."""
    ends = ((seen.low[0], image.high[0]), (image.low[0], seen.high[0]))
    low, high = max(ends, key=lambda pair: float(pair[1] - pair[0]))
    return replace(seen, low=np.array([low, *seen.low[1:]]), high=np.array([max(low, high), *seen.high[1:]]))


def _share_by_place(seen: Box, image: Box, apart: float) -> float:
    """Energy share of the ghosts in an image of targets distributed uniformly over ``seen``.

    With one aperture common to all pixels a target repeats with its full energy at every multiple of ``apart`` (m)
    within the image.
    """
    place = np.linspace(float(seen.low[0]), float(seen.high[0]), 101)
    before = np.floor((place - image.low[0]) / apart)
    after = np.floor((image.high[0] - place) / apart)
    ghosts = float((np.maximum(before, 0.0) + np.maximum(after, 0.0)).mean())
    return ghosts / (1.0 + ghosts)


def _share_by_beam(radar: Radar, step: float, farthest: float) -> float:
    r"""Energy share of azimuth ambiguities with a beam that passes over the pixels one after the other.

    .. math:: A = \sum_{0 < |k| \le n} \int_{-s_a}^{s_a} G^2(s + k \Delta) ds / \int_{-s_a}^{s_a} G^2(s) ds

    with the two-way power G^2 of the pattern, half aperture s_a and, at a pulse repetition frequency f_p,
    Delta = lambda f_p / (2 v); the share is A / (1 + A).

    Parameters
    ----------
    radar : gives pattern and half aperture
    step : Delta
    farthest : length of the image and its ghosts in steps of Delta
    """
    sine = np.linspace(-radar.half_aperture, radar.half_aperture, 257)
    n = np.floor(min(farthest, _MOST_AMBIGUITIES))
    order = np.arange(-n, n + 1.0)[:, None]
    shifted = np.clip(sine + order * step, -1.0, 1.0)
    power = np.asarray(radar.antenna.two_way_amplitude(shifted, np.zeros_like(shifted))) ** 2
    total = power.sum(axis=1)
    wrong = float(total[order[:, 0] != 0.0].sum())
    whole = wrong + float(total[order[:, 0] == 0.0].sum())
    return wrong / whole if whole > 0.0 else 0.0  # a beam without gain there gives no ghosts


def _span(box: Box, axis: int) -> str:
    return f"{box.low[axis]:.6g} to {box.high[axis]:.6g} m"
