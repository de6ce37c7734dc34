"""Phase gradient autofocus of prominent points, for spotlight and, with apertures that overlap, for stripmap."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.signal.focusing.autofocus import (
    AUTOFOCUSERS,
    Autofocuser,
    AutofocusTask,
    pulse_contributions,
    remove_trend,
)
from sarmitsuba.signal.focusing.focuser import option

# part of the peak, in power, at which the mean blur ends, and what its width is multiplied by (Wahl)
_EDGE, _WIDEN = 0.1, 1.5
# azimuth rows in which points are looked for apart, where pixels have apertures of their own: per aperture
_BLOCKS = 4.0
# share of the strongest pulse's level below which a pulse gives no estimate of its error
_DARK = 1e-3
# update below which no more rounds are made, rad rms
_SMALL = 0.05


@dataclass(frozen=True)
class PhaseGradient(Autofocuser):
    r"""Phase gradient autofocus.

    The brightest pixels' phase histories (:func:`sarmitsuba.signal.focusing.autofocus.pulse_contributions`), low-pass
    filtered to the width of the blur, give the maximum-likelihood estimate of the error's gradient over the pulses,

    .. math:: \dot\phi_t = \arg \sum_p g_{p,t}^* \, g_{p,t+1} \, e^{-j s_p}

    with :math:`s_p` the slope that the point's distance from its blurred peak makes. It is integrated, removed from the
    data, and the image is made again. As histories follow the recorded track at each point's range, any mode, track
    and focuser is possible. Where pixels have their own apertures (stripmap), every pulse uses the points that it
    illuminates; the slopes :math:`s_p` connect neighbouring sub-apertures.

    Notes
    -----
    Source: D. E. Wahl, P. H. Eichel, D. C. Ghiglia, C. V. Jakowatz, IEEE Trans. Aerosp. Electron. Syst. 30 (1994), 827;
    the estimator: C. V. Jakowatz, D. E. Wahl, J. Opt. Soc. Am. A 10 (1993), 2539. Ignores that the error along the line
    of sight varies over the scene. A shift of the whole image is neither estimated nor introduced.
    """

    name: ClassVar[str] = "phase_gradient"
    title: ClassVar[str] = "bright points that stand out, spotlight and stripmap"

    rounds: int = option(8, "largest number of images made", within=(1, 1000))
    points: int = option(200, "largest number of bright pixels used", within=(1, 10**9))

    def estimate(self, task: AutofocusTask) -> F64:
        """See the class."""
        radar = task.raw.radar
        wavenumber = 4.0 * np.pi / radar.waveform.wavelength
        error, seen = np.zeros(radar.track.n_pulses), np.ones(radar.track.n_pulses)
        width = np.inf
        for done in range(self.rounds):
            raw = task.corrected(error)
            places = self._bright(task, task.image(error))
            history = pulse_contributions(raw.data[0], radar, places, task.range_window, "rectangular")
            history, width = _low_pass(history, width)
            phase, seen = _integrate_history(history)
            update = remove_trend(radar, -phase / wavenumber, seen)
            error = error + update
            task.progress("autofocus", done + 1.0, float(self.rounds), {})
            if wavenumber * np.sqrt(np.mean(update**2)) < _SMALL:
                break
        return remove_trend(radar, error, seen)

    def _bright(self, task: AutofocusTask, image: C64) -> F64:
        """Positions (n, 3) of the brightest pixel in every column, and in every block of rows in stripmap."""
        grid, radar = task.grid, task.raw.radar
        rows = grid.azimuth.size
        blocks = 1
        if np.isfinite(radar.half_aperture):
            distance = float(np.linalg.norm(radar.aim_point - radar.track.center_position))
            aperture = 2.0 * radar.half_turn * distance
            blocks = int(np.clip(np.ceil(_BLOCKS * np.ptp(grid.azimuth) / aperture), 1, rows))
        power = np.abs(image) ** 2
        found = []
        for part in np.array_split(np.arange(rows), blocks):
            peak = part[0] + np.argmax(power[part], axis=0)
            strength = power[peak, np.arange(power.shape[1])]
            best = np.argsort(strength)[::-1][: max(1, self.points // blocks)]
            found += [(int(peak[column]), int(column)) for column in best if strength[column] > 0.0]
        return np.array([grid.positions_on_line(row)[column] for row, column in found])


def _low_pass(history: C64, most: float) -> tuple[C64, float]:
    """Histories (n, n_pulses) with the blur's band about each point kept, and that band's width, at most ``most``."""
    n = history.shape[1]
    length = int(scipy.fft.next_fast_len(2 * n))
    spectrum = scipy.fft.fft(history, n=length, axis=1, workers=-1)
    power = np.mean(np.abs(spectrum) ** 2, axis=0)
    offset = np.abs(scipy.fft.fftfreq(length, 1.0 / length))
    wide = offset[power > _EDGE * power.max()].max()
    # never below two cells of the aperture, where the point itself would be cut
    width = float(max(min(_WIDEN * wide, most), 2.0 * length / n))
    spectrum[:, offset > width] = 0.0
    return scipy.fft.ifft(spectrum, axis=1, workers=-1)[:, :n].astype(np.complex64), 0.7 * width


def _integrate_history(history: C64) -> tuple[F64, F64]:
    """Phase error (n_pulses,) rad from low-pass histories (n, n_pulses), and the signal power in every pulse.

    The slopes of the points are those of the weighted least squares over all gradients, of points and pulses together.
    """
    step = np.conj(history[:, :-1]) * history[:, 1:]
    weight, angle = np.abs(step).astype(np.float64), np.angle(step)
    lit = weight.sum(axis=0)
    share = weight / np.where(lit > 0.0, lit, 1.0)
    matrix = np.diag(weight.sum(axis=1)) - share @ weight.T
    right = (weight * angle).sum(axis=1) - share @ (weight * angle).sum(axis=0)
    slope = np.linalg.lstsq(matrix, right, rcond=1e-9)[0]
    gradient = np.angle((step * np.exp(-1j * slope)[:, None]).sum(axis=0))
    gradient[lit < _DARK * lit.max()] = 0.0
    return np.concatenate([[0.0], np.cumsum(gradient)]), np.concatenate([lit[:1], lit])


AUTOFOCUSERS.register(PhaseGradient())
