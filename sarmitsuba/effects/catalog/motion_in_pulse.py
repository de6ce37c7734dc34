"""Motion of the antenna within the pulse: between transmission and reception, and while the chirp lasts."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.text import length
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.receiver import moving_in_pulse
from sarmitsuba.scene.scene import Scene


class MotionInPulse(Effect):
    r"""Motion within the pulse; on where it shifts echoes in range or phase (no start-stop approximation).

    With the chirp's rate :math:`\gamma = B / T_p`, an echo of range R and range rate :math:`\dot R` appears
    shifted by :math:`\dot R f_c / \gamma` in range, and has the phase of the range at its own arrival, which is
    :math:`2 (R - R_0) / c` after that of the aim point's echo.
    """

    name = "motion_in_pulse"
    title = "motion within the pulse"
    documentation = "motion of the antenna within the pulse: until reception, and Doppler within the chirp"
    off_when = "echoes are shifted by less than the tolerance"
    off_means = "start-stop approximation: the antenna is at rest during every pulse"
    rank = 138
    at_key_pulses = False

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        radar = context.scene.radar
        if context.scene.settings.one_look:
            return Assessment(
                False, f"method {context.scene.settings.method} uses one antenna position", -np.inf
            )
        wave, n = radar.waveform, radar.track.n_pulses
        few = radar.of_pulses(np.unique(np.linspace(0, n - 1, min(n, 33)).round().astype(int)))
        kappa = wave.center_frequency / wave.chirp_rate
        rate, beyond = _widest(few, context)
        shift = abs(kappa) * rate
        # rms over the band of the phase of a range shift, and the phase at the carrier
        phase = np.hypot(
            np.pi / np.sqrt(3.0) * shift / wave.range_cell, 4.0 * np.pi / wave.wavelength * beyond
        )
        error = 20.0 * float(np.log10(max(min(phase, 2.0), 1e-30)))
        why = f"echoes shifted by up to {length(shift)} in range, {length(beyond)} of phase"
        return Assessment(error > context.tolerance_db, why, error)

    def within(self, scene: Scene) -> Scene:
        """Scene with the receiver at the antenna's position when the echo arrives."""
        return replace(scene, radar=moving_in_pulse(scene.radar))


def _widest(radar: Radar, context: SceneContext) -> tuple[float, float]:
    """Largest range rate of the scene (m/s), and largest range rate over c times the range from the aim point, m."""
    rate = np.array([radar.range_rate(corner) for corner in context.corners])
    beyond = np.array([radar.slant_range(corner) for corner in context.corners])
    beyond = beyond - radar.slant_range(radar.aim_point)
    return float(np.abs(rate).max()), float(np.abs(rate * beyond).max()) / SPEED_OF_LIGHT


EFFECTS.register(MotionInPulse())
