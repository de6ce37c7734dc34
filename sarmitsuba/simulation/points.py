"""Ideal point scatterers: analytic echoes, hidden where a mesh stands in the way."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import device_array, mi
from sarmitsuba.constants import SPEED_OF_LIGHT, SUBSET_SHARES
from sarmitsuba.echo.in_pulse import InPulse, carrier_range
from sarmitsuba.echo.raw import Layer
from sarmitsuba.echo.sub_bands import SubBands
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.polarisation import isotropic_response
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.point_ways import PointWay, in_the_way, panes_pass
from sarmitsuba.simulation.tracing import polarisation_up
from sarmitsuba.trace.geometry import TraceScene

# pulses of one NumPy batch times samples; bounds temporaries to about 100 MB
_BATCH = 2_000_000
# m; a point so near a facet lies on it: meshes and heights read from files are hardly more exact
ON_SURFACE = 1e-3


def add_points(
    scene: Scene,
    flags: KernelFlags,
    trace_scene: TraceScene | None,
    data: NDArray[np.complex64],
    layers: Sequence[Layer],
    sub_bands: int = 1,
) -> int:
    r"""Add every point target's exact band-limited echo to range-compressed data.

    .. math:: K \sqrt{\sigma} e^{j \phi} g_t / (R_t R_r) \, \mathrm{sinc}((r - R) / \Delta r) e^{-j 4 \pi f_c R / c}

    with :math:`R = (R_t + R_r) / 2` half the way from the transmitter to the receiver, mostly one antenna.

    Parameters
    ----------
    scene, flags : what to add and whether the antenna pattern counts
    trace_scene : what can hide a point, or None
    data : (n_layers, n_pulses, n_samples) complex64, changed in place; layers of the first order only
    layers : labels of ``data``
    sub_bands : number of frequencies at which what stands in the way is looked at

    Returns
    -------
    n : visible point-pulses added

    Notes
    -----
    An ideal scatterer is isotropic and does not depolarise (a compact channel has its part of HH = VV); it neither
    blocks nor reflects rays. On a surface it has no image in that surface, and a sheet without thickness that it lies
    on hides it from neither side.
    """
    radar = scene.radar
    track, window = radar.track, radar.window
    wavelength = radar.waveform.wavelength
    hindered = in_the_way(trace_scene, flags)
    factors = {  # both ray subsets see the whole point
        i: np.complex64(isotropic_response(layer.channel) * SUBSET_SHARES[layer.subset])
        for i, layer in enumerate(layers)
        if layer.order in (0, 1) and (isotropic_response(layer.channel) or hindered is not None)
    }
    wave = radar.waveform
    bands = SubBands(wave.center_frequency, wave.bandwidth, 1 if hindered is None else sub_bands)
    standing = (None,) if hindered is None else over_band(scene, hindered, bands)
    sample = np.arange(window.n_samples) * window.sample_spacing
    moving = InPulse.of(radar, slice(None))
    added = 0
    step = max(1, _BATCH // window.n_samples)
    for start in range(0, track.n_pulses, step):
        pick = slice(start, start + step)
        seen = sightlines(scene, flags, trace_scene, pick)
        for point, sight in zip(scene.points, seen, strict=True):
            distance, amplitude = point_returns(scene, flags, point, pick)
            amplitude = amplitude * sight
            added += int(np.count_nonzero(amplitude))
            for index, there in enumerate(standing):
                ways = ways_of(
                    scene, flags, there, point, pick, SPEED_OF_LIGHT / float(bands.frequencies[index])
                )
                apart = distance
                if ways is not None:
                    apart = distance + 0.5 * (ways[0].extra + ways[1].extra)
                place = apart
                if moving is not None:
                    rate = point_history(radar, point, pick)[1]
                    apart = carrier_range(apart, rate, moving.range_per_rate, moving.reference[pick])
                    place = apart + moving.range_per_rate * rate
                offset = (window.start_range[pick, None] + sample - place[:, None]) / wave.range_cell
                echo = (amplitude * np.exp(-1j * (4 * np.pi / wavelength * apart - point.phase)))[:, None]
                response = np.sinc(offset) if bands.count == 1 else bands.response(index, offset)
                profile = (echo * response).astype(np.complex64)
                for i, factor in factors.items():
                    if ways is not None:
                        share = ways[0].channel(ways[1], layers[i].channel) * SUBSET_SHARES[layers[i].subset]
                        data[i, pick] += profile * share.astype(np.complex64)[:, None]
                    else:
                        data[i, pick] += profile * factor
    return added


def over_band(scene: Scene, hindered: TraceScene, bands: SubBands) -> tuple[TraceScene, ...]:
    """What stands in the way, at each traced frequency."""
    if bands.count == 1:
        return (hindered,)
    return tuple(
        hindered.at_frequency(tuple(m.at_frequency(f) for m in scene.materials), SPEED_OF_LIGHT / f)
        for f in bands.frequencies.tolist()
    )


def ways_of(
    scene: Scene,
    flags: KernelFlags,
    hindered: TraceScene | None,
    point: PointTarget,
    pick: slice,
    wavelength: float,
) -> tuple[PointWay, PointWay] | None:
    """The ways of a point's waves out and home in the pulses ``pick``; None where nothing stands in them.

    Parameters
    ----------
    hindered : the scene where something may, see :func:`in_the_way`
    wavelength : m
    """
    if hindered is None:
        return None
    radar = scene.radar
    time = radar.track.time[pick]
    position = point.position_at(time)
    both = []
    for track in radar.tracks:
        antenna = track.position[pick]
        if hindered.movers is None:
            both.append(way_through(hindered, flags, radar, position, antenna, wavelength))
            continue
        each = zip(time, position, antenna, strict=True)
        both.append(
            PointWay.joined(
                [
                    way_through(hindered.at(float(t)), flags, radar, p[None], a[None], wavelength)
                    for t, p, a in each
                ]
            )
        )
    return both[0], both[-1]


def way_through(
    trace_scene: TraceScene,
    flags: KernelFlags,
    radar: Radar,
    position: NDArray[np.float64],
    antenna: NDArray[np.float64],
    wavelength: float,
) -> PointWay:
    """Ways from points to one antenna, both (n, 3) m, through panes and volumes, at a wavelength, m."""
    leg = antenna - position
    start = off_surfaces(trace_scene, position, leg / np.linalg.norm(leg, axis=1)[:, None])
    up = polarisation_up(radar, position[len(position) // 2], radar.track.center_position)
    return PointWay.of(trace_scene, flags, wavelength, start, antenna, up)


def point_returns(
    scene: Scene, flags: KernelFlags, point: PointTarget, pick: slice
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slant range (m) and co-polar amplitude (sqrt(W)) of a point that the pulses ``pick`` see, two (n,) float64."""
    radar = scene.radar
    position = point.position_at(radar.track.time[pick])
    legs = [position - track.position[pick] for track in radar.tracks]
    distances = [np.linalg.norm(leg, axis=1) for leg in legs]
    amplitude = radar.amplitude_constant * np.sqrt(point.rcs) / (distances[0] * distances[-1])
    if flags.antenna_pattern:
        gains = [
            _two_way_gain(radar.antenna, p, pick, leg / distance[:, None])
            for p, leg, distance in zip(radar.pointings, legs, distances, strict=True)
        ]
        amplitude *= gains[0] if len(gains) == 1 else np.sqrt(gains[0] * gains[1])
    return radar.slant_range(position, pick), amplitude


def _two_way_gain(
    antenna: Antenna, pointing: Pointing, pick: slice, u: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Gain of one antenna for both ways in the directions u (n, 3), zero behind the aperture."""
    gain = antenna.two_way_amplitude(
        np.sum(u * pointing.azimuth_axis[pick], axis=1), np.sum(u * pointing.elevation_axis[pick], axis=1)
    )
    return np.asarray(gain * (np.sum(u * pointing.boresight[pick], axis=1) > 0))


def point_history(
    radar: Radar, point: PointTarget, pick: slice
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slant range (m) of a point in the pulses ``pick`` and its change (m/s), two (n,) float64."""
    time = radar.track.time[pick]
    position, own = point.position_at(time), point.motion.velocity_at(time)
    rates = []
    for track in radar.tracks:
        way = track.position[pick] - position
        rate = np.einsum("ni,ni->n", way, track.velocity[pick] - own) / np.linalg.norm(way, axis=1)
        rates.append(rate)
    rate = rates[0] if len(rates) == 1 else 0.5 * (rates[0] + rates[1])
    return radar.slant_range(position, pick), rate


def sightlines(
    scene: Scene, flags: KernelFlags, trace_scene: TraceScene | None, pick: slice
) -> NDArray[np.float64]:
    """1 where a point sees every antenna in the pulses ``pick``, else 0: (n_points, n); see `visible`."""
    points, tracks = scene.points, scene.radar.tracks
    time = tracks[0].time[pick]
    position = np.array([point.position_at(time) for point in points])
    seen = np.ones(position.shape[:2])
    if trace_scene is None:
        return seen
    through_panes = panes_pass(trace_scene, flags)
    for track in tracks:
        leg = position - track.position[pick]
        distance = np.linalg.norm(leg, axis=2)
        if trace_scene.movers is None:
            ways = zip(position, leg, distance, strict=True)
            each = [visible(trace_scene, *way, through_panes=through_panes) for way in ways]
            seen *= np.array(each).reshape(seen.shape)
            continue
        ways = zip(np.swapaxes(position, 0, 1), np.swapaxes(leg, 0, 1), distance.T, strict=True)
        each = [
            visible(trace_scene.at(float(t)), *way, through_panes=through_panes)
            for t, way in zip(time, ways, strict=True)
        ]
        seen *= np.array(each).reshape(seen.T.shape).T
    return seen


def visible(
    trace_scene: TraceScene,
    position: NDArray[np.float64],
    leg: NDArray[np.float64],
    distance: NDArray[np.float64],
    *,
    through_panes: bool = False,
) -> NDArray[np.float64]:
    """1 where the straight way from points to the antenna is free, else 0; (n,) float64.

    A point on a surface (``ON_SURFACE``) is not hidden by the facets that it touches: its ray starts off their planes,
    on the antenna's side. One farther behind a surface stays hidden.

    Parameters
    ----------
    position : (3,) or (n, 3) m
    leg, distance : (n, 3) and (n,) m, from the antenna to the points
    through_panes : panes hide nothing
    """
    blocking = trace_scene.mi_scene
    if through_panes and trace_scene.slabs is not None:
        if trace_scene.slabs.walls is None:
            return np.ones(len(distance))
        blocking = trace_scene.slabs.walls
    away = -leg / distance[:, None]
    start = off_surfaces(trace_scene, np.broadcast_to(position, away.shape), away)
    origin, direction, (far,) = (
        [device_array(mi.Float, row.astype(np.float32)) for row in rows]
        for rows in (start.T, away.T, distance[None])
    )
    ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction), far, 0.0, [])
    return 1.0 - np.asarray(blocking.ray_test(ray), dtype=np.float64)


def off_surfaces(
    trace_scene: TraceScene, position: NDArray[np.float64], away: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Where ways from points (n, 3) along ``away`` (n, 3) start: off the facets that the points lie on, (n, 3) m."""
    start = position.copy()
    points, owner = np.unique(position, axis=0, return_inverse=True)
    for i, point in enumerate(points):
        mine = np.flatnonzero(owner.reshape(-1) == i)
        touched = touched_facets(trace_scene.triangles, point, max(ON_SURFACE, trace_scene.clearance))
        start[mine] += off_planes(touched, point, away[mine], trace_scene.clearance)
    return start


def touched_facets(
    triangles: NDArray[np.float64], point: NDArray[np.float64], reach: float
) -> NDArray[np.float64]:
    """Those of the triangles (n, 3, 3) that lie within ``reach`` of the point, (m, 3, 3), m."""
    near = (triangles.min(axis=1) - reach <= point) & (point <= triangles.max(axis=1) + reach)
    triangles = triangles[near.all(axis=1)]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    on_plane = np.abs(np.einsum("ni,ni->n", point - triangles[:, 0], normal)) <= reach
    inside = np.full(len(triangles), True)
    beside = np.full(len(triangles), np.inf)
    for k in range(3):
        corner, edge = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        way = point - corner
        inside &= np.einsum("ni,ni->n", np.cross(normal, edge), way) >= 0.0
        share = np.einsum("ni,ni->n", way, edge) / np.einsum("ni,ni->n", edge, edge)
        foot = way - np.clip(share, 0.0, 1.0)[:, None] * edge
        beside = np.minimum(beside, np.linalg.norm(foot, axis=1))
    return np.asarray(triangles[(on_plane & inside) | (beside <= reach)])


def off_planes(
    triangles: NDArray[np.float64],
    point: NDArray[np.float64],
    direction: NDArray[np.float64],
    clearance: float,
) -> NDArray[np.float64]:
    """Steps (n, 3) that take a point off triangles' planes, to the side that each direction (n, 3) points to, m."""
    step = np.zeros_like(direction)
    for _ in range(8 if len(triangles) > 1 else 1):
        for a, b, c in triangles:  # each plane in turn, until all are cleared
            normal = np.cross(b - a, c - a)
            normal /= np.linalg.norm(normal)
            side = np.where(direction @ normal >= 0.0, 1.0, -1.0)
            height = side * ((point - a) @ normal + step @ normal)
            step += (np.maximum(clearance - height, 0.0) * side)[:, None] * normal
    return step


__all__ = [
    "ON_SURFACE",
    "add_points",
    "off_planes",
    "off_surfaces",
    "over_band",
    "point_history",
    "point_returns",
    "sightlines",
    "touched_facets",
    "visible",
    "way_through",
    "ways_of",
]
