"""Ideal point scatterers: analytic echoes, hidden where a mesh stands in the way."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import mi
from sarmitsuba.constants import SUBSET_SHARES
from sarmitsuba.echo.raw import Layer
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.scene import Scene
from sarmitsuba.trace.geometry import TraceScene

# pulses of one NumPy batch times samples; bounds temporaries to about 100 MB
_BATCH = 2_000_000


def add_points(
    scene: Scene,
    flags: KernelFlags,
    trace_scene: TraceScene | None,
    data: NDArray[np.complex64],
    layers: Sequence[Layer],
) -> int:
    r"""Add every point target's exact band-limited echo to range-compressed data.

    .. math:: K \sqrt{\sigma} e^{j \phi} g_t / R^2 \, \mathrm{sinc}((r - R) / \Delta r) e^{-j 4 \pi f_c R / c}

    Parameters
    ----------
    scene, flags : what to add and whether the antenna pattern counts
    trace_scene : what can hide a point, or None
    data : (n_layers, n_pulses, n_samples) complex64, changed in place; co-polar layers of the first order only
    layers : labels of ``data``

    Returns
    -------
    n : visible point-pulses added

    Notes
    -----
    An ideal scatterer is isotropic and does not depolarise; it neither blocks nor reflects rays.
    """
    radar = scene.radar
    track, window = radar.track, radar.window
    wavelength = radar.waveform.wavelength
    picks = [i for i, la in enumerate(layers) if la.channel[0] == la.channel[1] and la.order in (0, 1)]
    sample = np.arange(window.n_samples) * window.sample_spacing
    added = 0
    step = max(1, _BATCH // window.n_samples)
    for point in scene.points:
        for start in range(0, track.n_pulses, step):
            pick = slice(start, start + step)
            leg = point.position - track.position[pick]
            distance = np.linalg.norm(leg, axis=1)
            amplitude = radar.amplitude_constant * np.sqrt(point.rcs) / distance**2
            if flags.antenna_pattern:
                u = leg / distance[:, None]
                p = radar.pointing
                amplitude *= radar.antenna.two_way_amplitude(
                    np.sum(u * p.azimuth_axis[pick], axis=1), np.sum(u * p.elevation_axis[pick], axis=1)
                ) * (np.sum(u * p.boresight[pick], axis=1) > 0)
            if trace_scene is not None:
                amplitude = amplitude * visible(trace_scene, point.position, leg, distance)
            added += int(np.count_nonzero(amplitude))
            offset = (window.start_range[pick, None] + sample - distance[:, None]) / radar.waveform.range_cell
            echo = (amplitude * np.exp(-1j * (4 * np.pi / wavelength * distance - point.phase)))[:, None]
            profile = (echo * np.sinc(offset)).astype(np.complex64)
            for i in picks:  # both ray subsets see the whole point
                data[i, pick] += profile * np.float32(SUBSET_SHARES[layers[i].subset])
    return added


def visible(
    trace_scene: TraceScene,
    position: NDArray[np.float64],
    leg: NDArray[np.float64],
    distance: NDArray[np.float64],
) -> NDArray[np.float64]:
    """1 where the straight way from points (3,) or (n, 3) to the antenna is free, else 0; (n,) float64."""
    d = (-leg / distance[:, None]).astype(np.float32)
    n = d.shape[0]
    origin = np.broadcast_to(position.astype(np.float32), (n, 3))
    ray = mi.Ray3f(
        mi.Point3f(np.ascontiguousarray(origin.T)),
        mi.Vector3f(np.ascontiguousarray(d.T)),
        mi.Float(distance.astype(np.float32)),
        0.0,
        [],
    )
    return 1.0 - np.asarray(trace_scene.mi_scene.ray_test(ray), dtype=np.float64)


__all__ = ["add_points", "visible"]
