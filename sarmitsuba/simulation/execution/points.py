"""Ideal point scatterers: analytic echoes, with occlusion and transmission by meshes, for every method.

Legs go straight from a point to an antenna. A point that lies on facets has legs that start off them, on the side of
the antenna. Looks have the echoes on their grid.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from sarmitsuba.core.arrays import C64, C128, F64, I64, unit_rows
from sarmitsuba.core.constants import SPEED_OF_LIGHT, SUBSET_SHARES
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.radar.polarisation import RECEIVED, isotropic_response, linear_parts
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.aperture_weights import antennas_gain
from sarmitsuba.signal.look_grid import LookGrid
from sarmitsuba.signal.pulse_motion import InPulse, carrier_range
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.signal.sub_bands import SubBands
from sarmitsuba.simulation.execution.blame import blame_stages
from sarmitsuba.simulation.execution.tracing import polarisation_up
from sarmitsuba.tracing.kernel.leg import Surroundings, antenna_basis, straight_leg
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.kernel.stage import apply_at_echo, changes_echoes
from sarmitsuba.tracing.kernel.state import SCATTERER, Contribution
from sarmitsuba.tracing.scatterers.slabs.slab_coefficients import lets_waves_through

# m; distance within which a point counts as lying on a facet: meshes and heights in files are not more accurate
ON_SURFACE = 1e-3


def off_surfaces(trace_scene: TraceScene, position: F64, away: F64) -> F64:
    """Start points (n, 3) of legs from points (n, 3) along ``away`` (n, 3), off the facets that they touch, m."""
    start = position.copy()
    points, owner = np.unique(position, axis=0, return_inverse=True)
    for i, point in enumerate(points):
        mine = np.flatnonzero(owner.reshape(-1) == i)
        touched = _touched_facets(trace_scene.triangles, point, max(ON_SURFACE, trace_scene.clearance))
        start[mine] += _off_planes(touched, point, away[mine], trace_scene.clearance)
    return start


def _touched_facets(triangles: F64, point: F64, reach: float) -> F64:
    """Triangles (m, 3, 3), m, of (n, 3, 3), that lie within ``reach`` of the point."""
    near = (triangles.min(axis=1) - reach <= point) & (point <= triangles.max(axis=1) + reach)
    triangles = triangles[near.all(axis=1)]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal = unit_rows(normal)
    on_plane = np.abs(np.einsum("ni,ni->n", point - triangles[:, 0], normal)) <= reach
    inside = np.full(len(triangles), True)
    beside = np.full(len(triangles), np.inf)
    for k in range(3):
        corner, edge = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        step = point - corner
        inside &= np.einsum("ni,ni->n", np.cross(normal, edge), step) >= 0.0
        share = np.einsum("ni,ni->n", step, edge) / np.einsum("ni,ni->n", edge, edge)
        foot = step - np.clip(share, 0.0, 1.0)[:, None] * edge
        beside = np.minimum(beside, np.linalg.norm(foot, axis=1))
    return np.asarray(triangles[(on_plane & inside) | (beside <= reach)])


def _off_planes(
    triangles: F64,
    point: F64,
    direction: F64,
    clearance: float,
) -> F64:
    """Displacements (n, 3), m, that move a point off triangles' planes, to the side of each direction (n, 3)."""
    step = np.zeros_like(direction)
    for _ in range(8 if len(triangles) > 1 else 1):
        for a, b, c in triangles:  # each plane in turn, until all are cleared
            normal = np.cross(b - a, c - a)
            normal /= np.linalg.norm(normal)
            side = np.where(direction @ normal >= 0.0, 1.0, -1.0)
            height = side * ((point - a) @ normal + step @ normal)
            step += (np.maximum(clearance - height, 0.0) * side)[:, None] * normal
    return step


@dataclass(frozen=True, eq=False)
class PointLegs:
    """Straight legs between points and one antenna.

    Parameters
    ----------
    seen : (n,) float64, 1 where the leg is not occluded, else 0
    shift : (n, 3) float64, m, apparent shift of the antenna by slabs
    to_antenna : (n, 3) unit vectors
    waves : (n, 2, 2) complex128: H and V components (second axis) at the point of unit waves sent in H and V (first);
        the same for reception. None where legs are not attenuated
    """

    seen: F64
    shift: F64
    to_antenna: F64
    waves: C128 | None

    @property
    def delay(self) -> F64:
        """One-way delay (n,) of slabs, m."""
        return np.asarray(np.einsum("ni,ni->n", self.shift, self.to_antenna))

    @staticmethod
    def of(
        trace_scene: TraceScene | None,
        flags: KernelFlags,
        wavelength: float,
        position: F64,
        antenna: F64,
        up: tuple[float, float, float],
    ) -> "PointLegs":
        """Legs between points and an antenna, traced.

        A point on a surface is not occluded by the facets that it touches, see
        :func:`sarmitsuba.simulation.execution.points.off_surfaces`; a point farther behind a surface is.

        Parameters
        ----------
        trace_scene : objects that may occlude; None: free space
        flags : whether slabs transmit; facets occlude points also with ``visibility`` off
        wavelength : m
        position, antenna : (n, 3) float64, m
        up : vertical reference of the polarisation
        """
        leg = antenna - position
        to_antenna = unit_rows(leg)
        none = np.zeros(position.shape)
        if trace_scene is None:
            return PointLegs(np.ones(len(position)), none, to_antenna, None)
        around = Surroundings.of(trace_scene, replace(flags, visibility=True), wavelength, up)
        begin = _device(mi.Vector3f, off_surfaces(trace_scene, position, to_antenna))

        def departure(to: mi.Vector3f) -> tuple[mi.Vector3f, mi.Bool]:
            return begin, dr.full(mi.Bool, True, len(position))

        places = [_device(mi.Vector3d, rows) for rows in (position, antenna)]
        found = straight_leg(around, places[0], departure, places[1], mi.Vector3d(0.0))
        seen = np.asarray(found.seen, dtype=np.float64)
        if around.clear:
            return PointLegs(seen, none, to_antenna, None)
        sent = np.stack([_rows(re) + 1j * _rows(im) for re, im in (found.h, found.v)])
        basis = np.stack([_rows(x) for x, _ in antenna_basis(around, found.to_antenna)])
        apparent = _rows(found.to_antenna64) * np.asarray(found.length)[:, None]
        return PointLegs(seen, apparent - leg, to_antenna, np.einsum("ani,pni->nap", sent + none, basis))

    @staticmethod
    def at(
        trace_scene: TraceScene | None,
        flags: KernelFlags,
        wavelength: float,
        time: F64,
        position: F64,
        antenna: F64,
        up: tuple[float, float, float],
    ) -> "PointLegs":
        """Legs (n,) at different times (n,), s, each with moving shapes at their positions at that time."""
        if trace_scene is None or trace_scene.movers is None:
            return PointLegs.of(trace_scene, flags, wavelength, position, antenna, up)
        each = [
            PointLegs.of(trace_scene.at(float(t)), flags, wavelength, p[None], a[None], up)
            for t, p, a in zip(time, position, antenna, strict=True)
        ]
        return PointLegs.joined(each)

    @staticmethod
    def joined(legs: Sequence["PointLegs"]) -> "PointLegs":
        """Concatenation of several sets of legs."""
        waves = [leg.waves for leg in legs if leg.waves is not None]
        return PointLegs(
            np.concatenate([leg.seen for leg in legs]),
            np.concatenate([leg.shift for leg in legs]),
            np.concatenate([leg.to_antenna for leg in legs]),
            np.concatenate(waves) if waves else None,
        )

    def channel(self, home: "PointLegs", name: str) -> C128:
        """Response (n,) of a channel to an ideal point of unit RCS (HH = VV = 1), by these legs and back by ``home``.

        As :func:`isotropic_response` in free space. 0 where the point is occluded.
        """
        seen = self.seen * home.seen
        if self.waves is None or home.waves is None:
            return np.asarray(seen * isotropic_response(name), dtype=np.complex128)
        both = np.einsum("nap,nbp->nab", self.waves, home.waves)
        parts = [f * both[:, RECEIVED.index(p[0]), RECEIVED.index(p[1])] for f, p in linear_parts(name)]
        return np.asarray(seen * sum(parts))


def takes_part(trace_scene: TraceScene | None, flags: KernelFlags) -> bool:
    """Whether slabs or volumes act on straight legs, or stages on echoes: at each frequency, and in every channel."""
    within = trace_scene is not None and (
        bool(trace_scene.passages) or lets_waves_through(trace_scene.slabs, flags)
    )
    return within or changes_echoes(flags)


def build_legs(
    scene: Scene, trace_scene: TraceScene | None, bands: SubBands
) -> tuple[TraceScene | None, ...]:
    """Geometry that acts on straight legs, with the materials at each traced frequency."""
    if bands.count == 1 or trace_scene is None:
        return (trace_scene,) * bands.count
    return tuple(
        trace_scene.at_frequency(tuple(m.at_frequency(f) for m in scene.materials), SPEED_OF_LIGHT / f)
        for f in bands.frequencies.tolist()
    )


def _device(kind: type, rows: F64) -> "mi.Vector3d":
    """Rows (n, 3) as a Dr.Jit vector."""
    number = mi.Float64 if kind is mi.Vector3d else mi.Float
    return kind(*(device_array(number, np.ascontiguousarray(row)) for row in rows.T))


def _rows(vector: "mi.Vector3f") -> F64:
    """Rows (n, 3) of a Dr.Jit vector."""
    return np.asarray(vector, np.float64).T


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


@dataclass(frozen=True, eq=False)
class PointTaps:
    """Echoes of ideal points, spread over cells of the looks' grid.

    Parameters
    ----------
    point : (n,) number of the point
    row, column : (n,) first cell in range and azimuth
    values : (n_channels, n, width, width) complex128, in the cells from there
    """

    point: I64
    row: I64
    column: I64
    values: C128

    @staticmethod
    def joined(parts: Sequence["PointTaps"]) -> "PointTaps":
        """Echoes of several looks."""
        axis = {"values": 1}
        return PointTaps(
            *(
                np.concatenate([getattr(p, f.name) for p in parts], axis=axis.get(f.name, 0))
                for f in fields(PointTaps)
            )
        )

    def on(self, grid: LookGrid, values: C128) -> C64:
        """Grid (n_range, n_azimuth) with the values (n, width, width) of one channel added."""
        out = np.zeros((grid.n_range, grid.n_azimuth), dtype=np.complex128)
        for p in range(values.shape[1]):
            for q in range(values.shape[2]):
                np.add.at(out, (self.row + p, self.column + q), values[:, p, q])
        return out.astype(np.complex64)


def point_taps(
    grid: LookGrid, look: int, slant_range: F64, rate: F64, amplitude: C128, wavelength: float
) -> PointTaps:
    """A few paths spread on the grid of a look: ``ImageAccumulator`` in NumPy.

    Parameters
    ----------
    look : that sees them
    slant_range, rate : (n,) m and m/s
    amplitude : (n_channels, n) at that range
    """
    kernel = grid.kernel
    place, azimuth, distance = grid.coordinates(slant_range, rate, look)
    if grid.fan is not None:  # at the time when the beam passes over them
        amplitude = amplitude * (slant_range / distance) ** 2 * grid.share(azimuth, look)
    offset, x, y = grid.cells(place, azimuth)
    inside = (x >= kernel.margin) & (x <= grid.n_range - 1 - kernel.margin)
    inside &= (y >= kernel.margin) & (y <= grid.n_azimuth - 1 - kernel.margin)
    x, y, offset, amplitude = x[inside], y[inside], offset[inside], amplitude[:, inside]
    value = amplitude * np.exp(-4j * np.pi / wavelength * offset)
    base_x, base_y = np.floor(x + kernel.shift), np.floor(y + kernel.shift)
    taps_x = np.array(kernel.taps(x + kernel.shift - base_x))
    taps_y = np.array(kernel.taps(y + kernel.shift - base_y))
    spread = np.einsum("cn,pn,qn->cnpq", value, taps_x, taps_y)
    i, j = base_x.astype(np.int64) - kernel.lead, base_y.astype(np.int64) - kernel.lead
    return PointTaps(np.flatnonzero(inside), i, j, spread)
