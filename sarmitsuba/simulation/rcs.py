"""Radar cross section over look directions: the trace kernel in the far field, without pulses or images."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.backend import dr, mi
from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.errors import RadarError
from sarmitsuba.materials.material import Material
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.trace.accumulators import SumAccumulator
from sarmitsuba.trace.arrays import device_array
from sarmitsuba.trace.geometry import build_trace_scene
from sarmitsuba.trace.kernel import KernelSettings, trace
from sarmitsuba.trace.launch import PulseBatch, frame_towards, lattice, window_of

# lanes of one launch; bounds memory (a lane's outputs take about 100 bytes)
MAX_LANES = 4_000_000


@dataclass(frozen=True, eq=False)
class RcsResult:
    """Scattering amplitudes over directions.

    Parameters
    ----------
    amplitude : (n_directions, n_orders, n_channels) complex128, m; ``|.|^2`` is the RCS in m^2. One order (the sum)
        unless orders were kept
    channels : labels of the last axis
    rays_per_direction : rays in the launch window
    """

    amplitude: NDArray[np.complex128]
    channels: tuple[str, ...]
    rays_per_direction: int

    def rcs_dbsm(self, channel: str | None = None) -> NDArray[np.float64]:
        """(n_directions,) RCS of all orders summed coherently, dB above 1 m^2."""
        i = self.channels.index(channel) if channel else 0
        total = np.abs(self.amplitude[:, :, i].sum(axis=1)) ** 2
        with np.errstate(divide="ignore"):
            return np.asarray(10.0 * np.log10(total))


def monostatic_rcs(
    geometry: Geometry,
    materials: tuple[Material, ...],
    directions: ArrayLike,
    frequency: float,
    *,
    channels: tuple[str, ...] = ("HH", "VV"),
    ray_spacing: float = 0.0,
    max_depth: int = 3,
    distance: float = 0.0,
    keep_orders: bool = False,
    flags: KernelFlags | None = None,
    seed: int = 0,
) -> RcsResult:
    """Trace a target from many directions and return its scattering amplitudes.

    Parameters
    ----------
    geometry, materials : the target, scene frame
    directions : (n, 3) unit vectors from the target to the radar
    frequency : Hz
    ray_spacing : m; 0 = wavelength / 4.5
    max_depth : most bounces
    distance : m to the antenna; 0 = far enough for a plane wave (phase error over the target below 1e-4 rad)
    keep_orders : keep bounce numbers apart
    flags : effects; default all that the materials call for
    seed : shift and turn of the ray lattice

    Notes
    -----
    Phase is referred to the centre of the target's bounds. Ignores what the kernel ignores (edge diffraction).
    """
    wavelength = SPEED_OF_LIGHT / frequency
    look = np.atleast_2d(np.asarray(directions, dtype=np.float64))
    if look.ndim != 2 or look.shape[1] != 3 or not np.isfinite(look).all():
        raise RadarError(f"directions have the shape {look.shape}; (n, 3) finite vectors are needed")
    look = look / np.linalg.norm(look, axis=1, keepdims=True)
    low, high = geometry.bounds
    center, radius = 0.5 * (low + high), 0.5 * geometry.diameter
    spacing = ray_spacing or wavelength / 4.5
    # sagitta of the wave over the target is r^2 / 2R; two-way phase k r^2 / R
    far = distance or 2.0 * np.pi / wavelength * radius**2 / 1e-4
    position = center + look * far
    along = np.array([0.0, 1.0, 0.0])
    frame = frame_towards(position, center, along)
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    half = np.zeros(2)
    for i in range(look.shape[0]):
        one = frame_towards(position[i : i + 1], center, along)
        lo, hi = window_of(corners, position[i], one)
        half = np.maximum(half, np.maximum(np.abs(lo), np.abs(hi)))
    grid = lattice(half[0] + spacing, half[1] + spacing, spacing, seed=seed)
    if flags is None:
        flags = KernelFlags(
            channels=channels,
            fresnel=not all(m.pec for m in materials),
            roughness=any(m.rms_height > 0 for m in materials),
            diffuse=False,
            depolarisation=False,
            polarised_diffuse=False,
            antenna_pattern=False,
            spreading=True,
            taper=False,
            multi_bounce=max_depth > 1,
        )
    scene = build_trace_scene(geometry, materials, wavelength)
    settings = KernelSettings(
        wavelength=wavelength, max_depth=max_depth, cell=1.0, seed=seed, amplitude=far**2, reference_range=far
    )
    n_orders = max_depth if keep_orders else 1
    per_launch = max(1, MAX_LANES // grid.n_rays)
    parts = []
    for start in range(0, look.shape[0], per_launch):
        pick = slice(start, start + per_launch)
        batch = PulseBatch(
            position=position[pick],
            velocity=np.zeros_like(position[pick]),
            frame=type(frame)(frame.center[pick], frame.axis_x[pick], frame.axis_y[pick]),
        )
        reference = device_array(mi.Float64, np.full(batch.n_pulses, far))
        accumulator = SumAccumulator(wavelength, reference, len(channels), max_depth if keep_orders else 0)
        _, sums = trace(scene, grid, batch, flags, settings, Antenna(), accumulator)
        # lanes of one direction lie together
        parts.append(
            np.stack(
                [_sum_lanes(s.real, grid.n_rays) + 1j * _sum_lanes(s.imag, grid.n_rays) for s in sums],
                axis=-1,
            )
        )
    amplitude = np.concatenate(parts).reshape(look.shape[0], n_orders, len(channels))
    return RcsResult(amplitude, channels, grid.n_rays)


def _sum_lanes(values: "mi.Float", block: int) -> NDArray[np.float64]:
    return np.asarray(dr.block_sum(mi.Float64(values), block), dtype=np.float64)


__all__ = ["RcsResult", "monostatic_rcs"]
