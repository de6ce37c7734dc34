"""Noise-equivalent cell for beams only a few azimuth cells wide, whose gain varies within one cell."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.radar import Radar

# azimuth cells from the beam's centre to its first null above which the gain is constant over a cell: 0.003 dB
WIDE_BEAM = 16.0
# samples of the aperture, samples of the ground per azimuth cell, and extent of the clutter in nulls
_PULSES, _PER_CELL, _NULLS = 128, 4, 2.0


def beam_over_cell(radar: Radar, point: F64, weights: F64) -> float:
    r"""Noise-equivalent area of the impulse response, relative to that with the pixel's gain for all clutter.

    A pixel at p gives the echo of pulse t the weight :math:`W_t / g_t(p)` besides its phase. Clutter at q has its own
    gain g(q), so that

    .. math:: \frac{A}{A_0} = \frac{\int |\sum_t W_t \frac{g_t(q)}{g_t(p)} e^{-j k (R_t(q) - R_t(p))}|^2 dx}
              {2 \pi \sum_t W_t^2 / |\Delta \kappa_t|}, \quad \kappa = k \, \partial R_t / \partial x

    over the places q at the distance x from p along the circle of equal range. Exactly 1 for an isotropic antenna, and
    for a beam wider than ``WIDE_BEAM``.

    Parameters
    ----------
    radar : gives track, beam and waveform
    point : (3,) m, scene frame
    weights : (n_pulses,) W, of the echoes of a scatterer at that point

    Notes
    -----
    Ignores range walk of the clutter within its few cells, the pattern's change in elevation over a range cell, and the
    separate beam of a bistatic receiver.
    """
    if not radar.antenna.directive or not (weights > 0.0).any():
        return 1.0
    place = np.asarray(point, dtype=np.float64)
    lit = np.flatnonzero(weights > 1e-9 * weights.max())
    index = np.arange(weights.size)
    at = np.linspace(lit[0], lit[-1], min(_PULSES, int(lit[-1] - lit[0]) + 1))
    share = np.interp(at, index, weights)

    def between(rows: F64) -> F64:
        return np.stack([np.interp(at, index, column) for column in rows.T], axis=1)

    antennas = [between(track.position) for track in radar.tracks]
    wavenumber = 4.0 * np.pi / radar.waveform.wavelength
    middle = share @ antennas[0] / share.sum()
    out = place - middle
    reach = float(np.hypot(out[0], out[1]))
    if reach == 0.0:
        return 1.0
    sideways = np.array([-out[1], out[0], 0.0]) / reach
    wavenumbers = wavenumber * np.mean(
        [(place - a) @ sideways / np.linalg.norm(place - a, axis=1) for a in antennas], axis=0
    )
    if at.size < 2:
        return 1.0
    step = np.abs(np.gradient(wavenumbers))
    cell = 2.0 * np.pi / max(float(np.ptp(wavenumbers)), 1e-300)
    aside = radar.pointing.azimuth_axis @ sideways
    across = float(np.abs(np.interp(at[at.size // 2], index, aside)))
    null = radar.antenna.nulls[0] * float(np.linalg.norm(out)) / max(across, 0.1)
    if null > WIDE_BEAM * cell or not step.all():
        return 1.0

    pointing = radar.pointing
    azimuth, elevation, boresight = map(
        between, (pointing.azimuth_axis, pointing.elevation_axis, pointing.boresight)
    )

    def seen(where: F64) -> tuple[F64, F64]:
        """Slant ranges and two-way amplitudes of places (..., 1, 3)."""
        legs = [where - antenna for antenna in antennas]
        distances = [np.linalg.norm(leg, axis=-1) for leg in legs]
        sines = [np.sum(legs[0] * axis, axis=-1) / distances[0] for axis in (azimuth, elevation, boresight)]
        gain = np.asarray(radar.antenna.two_way_amplitude(sines[0], sines[1]))
        return 0.5 * (distances[0] + distances[-1]), np.where(sines[2] > 0.0, gain, 0.0)

    range_here, gain_here = seen(place)
    # up to the pulses' ambiguities
    farthest = min(_NULLS * null, np.pi / float(step.max()))
    # centres of whole steps: a shortened last step would vary abruptly from column to column of an image
    n = int(np.ceil(2.0 * farthest * _PER_CELL / cell))
    x = ((np.arange(n) + 0.5) * (2.0 / n) - 1.0) * farthest
    cosine, sine = np.cos(x / reach), np.sin(x / reach)
    turned = [out[0] * cosine - out[1] * sine, out[0] * sine + out[1] * cosine, np.full_like(x, out[2])]
    ranges, gains = seen((middle + np.stack(turned, axis=1))[:, None])
    held = np.where(gain_here > 0.0, share / np.maximum(gain_here, 1e-300), 0.0)
    response = (gains * np.exp(-1j * wavenumber * (ranges - range_here))) @ held
    area = float(np.sum(np.abs(response) ** 2)) * (2.0 * farthest / n)
    alike = 2.0 * np.pi * float(np.sum(share**2 / step))
    return area / alike
