"""Sampling requirements of water under wind: range rates and block length."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.materials.diffuse import water_in
from sarmitsuba.scene.materials.diffuse_law import WindWaves
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.materials.sea_spectrum import angular_frequency
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.planning.sampling.movers import BEAM_CHANGE, MOTION_PHASE, SHORTEST, beam_change

# bound on velocities, standard deviations: one scatterer in a million is faster
SIGMAS = 5.0
# allowed error of the gain relative to its peak, where it is steepest: about -25 dB over the aperture
BEAM_ERROR = 0.1
# standard deviation of tau^2 over a block |tau| <= T / 2, in T^2 / 4
_UNEVEN = float(np.sqrt(4.0 / 45.0))


def waters(scene: Scene) -> tuple[WindWaves, ...]:
    """Wind-wave models of the visible water surfaces of the scene."""
    used = [scene.materials[i] for i in np.unique(scene.geometry.face_material)]
    visible = list_with_parts([m for m in used if not m.invisible])
    return water_in(visible, scene.radar.waveform.wavelength, scene.settings.seed)


def fastest(scene: Scene) -> float:
    """Largest change of a range rate by the motion of water, m/s; 0 without water."""
    short = 2.0 * 2.0 * np.pi / scene.radar.waveform.wavelength  # wavenumber of the shortest Bragg waves
    bragg = float(angular_frequency(short)) / short
    return max(
        (SIGMAS * float(np.hypot(w.speeds[2], _rms(w, 1))) + bragg for w in waters(scene)), default=0.0
    )


def beam_tells(scene: Scene, reference: F64) -> bool:
    """Whether water is slow enough for its position in the beam to be derived from its range rate.

    The apparent position is displaced by R v / V along the track; the change of the gain over it is the error.

    Parameters
    ----------
    scene, reference : as for :func:`block_length`
    """
    radar, track = scene.radar, scene.radar.track
    if track.n_pulses < 2:
        return True
    speed = max((float(np.hypot(w.speeds[2], _rms(w, 1))) for w in waters(scene)), default=0.0)
    flown = float(np.linalg.norm(track.position[-1] - track.position[0])) / (track.n_pulses - 1)
    antenna_speed = float(np.linalg.norm(track.velocity[track.center_index]))
    travel = float(np.linalg.norm(reference - track.center_position)) * speed / max(antenna_speed, 1e-9)
    return beam_change(radar, reference, 2 * int(np.ceil(travel / max(flown, 1e-9)))) <= BEAM_ERROR


def block_length(scene: Scene, reference: F64, length: int, *, every_beam: bool) -> int:
    """Largest block length up to ``length`` for water; 1 where no blocks are possible.

    Within a block every scatterer keeps its velocity of the key pulse: the acceleration by the long waves is ignored.
    Where the gain is that of the key pulse, it
    must not change over a block either.

    Parameters
    ----------
    scene : with its radar
    reference : (3,) m, point at which the gain is evaluated
    length : upper bound from other criteria
    every_beam : whether every pulse has its own gain, see :func:`beam_tells`
    """
    found = waters(scene)
    if not found:
        return length
    track, wavelength = scene.radar.track, scene.radar.waveform.wavelength
    acceleration = max(_rms(w, 2) for w in found)
    pulse = float(np.ptp(track.time)) / max(track.n_pulses - 1, 1)
    if acceleration > 0.0 and pulse > 0.0:
        # 4 pi / lambda * a / 2 * deviation of tau^2
        span = np.sqrt(2.0 * MOTION_PHASE * wavelength / (np.pi * acceleration * _UNEVEN))
        length = min(length, int(span / pulse))
    while not every_beam and length > 1 and beam_change(scene.radar, reference, length) > BEAM_CHANGE:
        length = int(length / np.sqrt(2.0))
    return length if length >= SHORTEST else 1


def _rms(water: WindWaves, derivative: int) -> float:
    """Rms velocity (1) or acceleration (2) of the surface by the long waves, m/s or m/s^2."""
    omega, amplitude = water.waves[:, 2], water.waves[:, 4]
    return float(np.sqrt(0.5 * np.sum((amplitude * omega**derivative) ** 2)))
