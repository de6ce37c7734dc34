"""What the pulse rate lets a frequency-domain focuser do, for its statement of error and time."""

import numpy as np

from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.radar import Radar

# processor time of a data sample on one core of today: padded transforms and Stolt's mapping by eight taps
SAMPLE_SECONDS = 1.8e-6
# of the sampled band, the part that an image may take
_FILL = 0.9


def azimuth_fits(radar: Radar, grid: ImageGrid) -> bool:
    r"""Whether the pulse rate holds an image: what is wider folds over in the frequency domain.

    With d the pulses' distance, sines along the track span at most :math:`\lambda / 2 d`: of the image's corners seen
    from mid-aperture where all pixels share the pulses, of the processed aperture where each has its own.
    """
    track = radar.track
    if track.n_pulses < 2:
        return False
    spacing = float(np.linalg.norm(np.diff(track.position, axis=0), axis=1).max())
    room = _FILL * radar.waveform.wavelength / (2.0 * spacing)
    if np.isfinite(radar.half_aperture):
        return 2.0 * radar.half_aperture < room
    corners = np.array([grid.positions_on_line(row)[[0, -1]] for row in (0, -1)]).reshape(-1, 3)
    line = corners - track.center_position
    sine = line @ grid.along / np.linalg.norm(line, axis=1)
    return float(np.ptp(sine)) < room


__all__ = ["SAMPLE_SECONDS", "azimuth_fits"]
