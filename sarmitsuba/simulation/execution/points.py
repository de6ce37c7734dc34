"""Ideal point scatterers: analytic echoes, with occlusion by meshes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT, SUBSET_SHARES
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.radar.polarisation import isotropic_response
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.aperture_weights import antennas_gain
from sarmitsuba.signal.raw.pulse_motion import InPulse, carrier_range
from sarmitsuba.signal.raw.raw_data import Layer
from sarmitsuba.signal.raw.sub_bands import SubBands
from sarmitsuba.simulation.execution.blame import blame_stages
from sarmitsuba.simulation.execution.point_legs import PointLegs, build_legs, takes_part
from sarmitsuba.simulation.execution.tracing import polarisation_up
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.kernel.stage import apply_at_echo, changes_echoes
from sarmitsuba.tracing.kernel.state import SCATTERER, Contribution

# pulses times samples of one NumPy batch; bounds temporary arrays to about 100 MB
_BATCH = 2_000_000


@dataclass(frozen=True, eq=False)
class PointEcho:
    """Echoes of ideal points: of one point at n pulses, or of n points at one pulse.

    Parameters
    ----------
    slant_range, range_rate : (n,) float64, m and m/s, with the delay in slabs
    amplitude : (n,) complex128, sqrt(W), co-polar, in free space
    legs : to the transmitter and to the receiver
    changed : (n,) complex128 of each channel after the stages of the kernel; None without such stages
    """

    slant_range: F64
    range_rate: F64
    amplitude: C128
    legs: tuple[PointLegs, PointLegs]
    changed: Mapping[str, C128] | None = None

    @staticmethod
    def of(
        legs: Sequence[PointLegs],
        amplitude: C128,
        position: F64,
        velocity: F64,
        antennas: Sequence[tuple[F64, F64]],
    ) -> "PointEcho":
        r"""Echoes :math:`K \sqrt\sigma e^{j \phi} g / (R_t R_r)` at the range :math:`(R_t + R_r) / 2`.

        Parameters
        ----------
        legs : to each antenna
        amplitude : (n,) sqrt(W) m^2, without the ranges
        position, velocity : (n, 3) m and m/s, of the points
        antennas : position and velocity (n, 3) of each antenna, m and m/s
        """
        apparent = [(place + leg.shift, speed) for leg, (place, speed) in zip(legs, antennas, strict=True)]
        ranges, rates = _ranges_and_rates(position, velocity, apparent)
        return PointEcho(
            _mean(ranges), _mean(rates), amplitude / (ranges[0] * ranges[-1]), (legs[0], legs[-1])
        )

    @property
    def seen(self) -> F64:
        """Visibility (n,): 1 where neither leg is occluded, else 0."""
        return self.legs[0].seen * self.legs[1].seen

    def channel(self, name: str) -> C128:
        """Amplitude (n,) complex128, sqrt(W), of a channel, without the phase of the slant range; 0 where occluded."""
        if self.changed is not None:
            return self.changed[name]
        return np.asarray(self.amplitude * self.legs[0].channel(self.legs[1], name))

    def through_stages(self, flags: KernelFlags, wavelength: float, position: F64) -> "PointEcho":
        """Echoes after the stages of the kernel; ``position``: (n, 3) m, of the points."""
        if not changes_echoes(flags):
            return self
        n = len(self.slant_range)
        each = [self.channel(channel) for channel in flags.channels]
        echo = apply_at_echo(
            flags,
            mi.Float(2.0 * np.pi / wavelength),
            Contribution(
                kind=mi.UInt32(SCATTERER),
                order=mi.UInt32(1),
                pulse=dr.arange(mi.UInt32, n),
                slant_range=mi.Float64(self.slant_range),
                range_rate=mi.Float64(self.range_rate),
                amplitudes=tuple(mi.Complex2f(mi.Float(x.real), mi.Float(x.imag)) for x in each),
                active=dr.full(mi.Bool, True, n),
                point=mi.Vector3d(*np.ascontiguousarray(position.T)),
            ),
        )
        kept = np.broadcast_to(np.asarray(echo.active), n)
        if not dr.all(echo.finite | ~echo.active):
            blame_stages(flags, "ideal point", lambda _: True)
        amplitudes = (
            kept * np.broadcast_to(np.asarray(x.real) + 1j * np.asarray(x.imag), n) for x in echo.amplitudes
        )
        return replace(
            self,
            slant_range=np.broadcast_to(np.asarray(echo.slant_range), n),
            range_rate=np.broadcast_to(np.asarray(echo.range_rate), n),
            changed={c: x.astype(np.complex128) for c, x in zip(flags.channels, amplitudes, strict=True)},
        )


def point_echo(
    scene: Scene,
    flags: KernelFlags,
    trace_scene: TraceScene | None,
    point: PointTarget,
    pick: slice,
    wavelength: float,
) -> PointEcho:
    """Echoes of one ideal point in the pulses ``pick``.

    Parameters
    ----------
    scene, flags : radar, and whether the antenna pattern is applied
    trace_scene : geometry that may occlude, at time zero; None: free space
    wavelength : m, for transmission through slabs and volumes
    """
    radar = scene.radar
    time = radar.track.time[pick]
    position = point.position_at(time)
    antennas = [(track.position[pick], track.velocity[pick]) for track in radar.tracks]
    up = polarisation_up(radar, position[len(position) // 2], radar.track.center_position)
    legs = [PointLegs.at(trace_scene, flags, wavelength, time, position, place, up) for place, _ in antennas]
    amplitude = np.full(
        len(position), radar.amplitude_constant * np.sqrt(point.rcs) * np.exp(1j * point.phase)
    )
    if flags.antenna_pattern:
        amplitude *= antennas_gain(radar, pick, [-leg.to_antenna for leg in legs])
    echo = PointEcho.of(legs, amplitude, position, point.motion.velocity_at(time), antennas)
    return echo.through_stages(flags, wavelength, position)


def add_points(
    scene: Scene,
    flags: KernelFlags,
    trace_scene: TraceScene | None,
    data: C64,
    layers: Sequence[Layer],
    sub_bands: int = 1,
) -> int:
    r"""Add the exact band-limited echoes of all ideal points to range-compressed data.

    .. math:: K \sqrt{\sigma} e^{j \phi} g_t / (R_t R_r) \, \mathrm{sinc}((r - R) / \Delta r) e^{-j 4 \pi f_c R / c}

    with :math:`R = (R_t + R_r) / 2`, half the path from the transmitter to the receiver (often one antenna).

    Parameters
    ----------
    scene, flags : scene with the points, and whether the antenna pattern is applied
    trace_scene : geometry that may occlude a point, or None
    data : (n_layers, n_pulses, n_samples) complex64, changed in place; layers of the first order only
    layers : labels of ``data``
    sub_bands : number of frequencies at which transmission is computed

    Returns
    -------
    n : visible point-pulses added

    Notes
    -----
    An ideal scatterer is isotropic and does not depolarise (a compact channel has its component of HH = VV); it neither
    occludes nor reflects rays. A point on a surface has no image in that surface, and a sheet without thickness does
    not occlude a point that lies on it, from either side.
    """
    radar = scene.radar
    track, window = radar.track, radar.window
    wave = radar.waveform
    partly = takes_part(trace_scene, flags)
    wanted = {  # both ray subsets hold the full echo of the point
        i: layer
        for i, layer in enumerate(layers)
        if layer.order in (0, 1) and (isotropic_response(layer.channel) or partly)
    }
    bands = SubBands(wave.center_frequency, wave.bandwidth, sub_bands if partly else 1)
    standing = build_legs(scene, trace_scene, bands)
    sample = np.arange(window.n_samples) * window.sample_spacing
    moving = InPulse.of(radar, slice(None))
    added = 0
    step = max(1, _BATCH // window.n_samples)
    for start in range(0, track.n_pulses, step):
        pick = slice(start, start + step)
        for point in scene.points:
            for index, there in enumerate(standing):
                wavelength = SPEED_OF_LIGHT / float(bands.frequencies[index])
                echo = point_echo(scene, flags, there, point, pick, wavelength)
                added += 0 if index else int(np.count_nonzero(echo.amplitude * echo.seen))
                apart = place = echo.slant_range
                if moving is not None:
                    rate = echo.range_rate
                    apart = carrier_range(apart, rate, moving.range_per_rate, moving.reference[pick])
                    place = apart + moving.range_per_rate * rate
                offset = (window.start_range[pick, None] + sample - place[:, None]) / wave.range_cell
                phase = np.exp(-4j * np.pi / wave.wavelength * apart)[:, None]
                response = np.sinc(offset) if bands.count == 1 else bands.response(index, offset)
                profile = (phase * response).astype(np.complex64)
                for i, layer in wanted.items():
                    share = echo.channel(layer.channel) * SUBSET_SHARES[layer.subset]
                    data[i, pick] += profile * share.astype(np.complex64)[:, None]
    return added


def point_history(radar: Radar, point: PointTarget, pick: slice) -> tuple[F64, F64]:
    """Slant range (m) and range rate (m/s) of a point in the pulses ``pick``, two (n,) float64, in free space."""
    time = radar.track.time[pick]
    position, own = point.position_at(time), point.motion.velocity_at(time)
    antennas = [(track.position[pick], track.velocity[pick]) for track in radar.tracks]
    ranges, rates = _ranges_and_rates(position, own, antennas)
    return _mean(ranges), _mean(rates)


def _ranges_and_rates(
    position: F64, velocity: F64, antennas: Sequence[tuple[F64, F64]]
) -> tuple[list[F64], list[F64]]:
    """Range (m) of points to each antenna and range rate (m/s), (n,) each, from positions and velocities (n, 3)."""
    ranges, rates = [], []
    for place, speed in antennas:
        line = place - position
        distance = np.linalg.norm(line, axis=1)
        ranges.append(distance)
        rates.append(np.einsum("ni,ni->n", line, speed - velocity) / distance)
    return ranges, rates


def _mean(values: Sequence[F64]) -> F64:
    """Mean over one antenna or two."""
    return values[0] if len(values) == 1 else np.asarray(0.5 * (values[0] + values[1]))
