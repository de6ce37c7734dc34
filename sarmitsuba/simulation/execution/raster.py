"""Method ``raster``: image by projection of the visible surface, with incoherent sigma0 and random speckle."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F32, F64
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.units import amplitude_from_db
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.radar.polarisation import linear_parts
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.tracing.kernel.accumulators import rounded_size
from sarmitsuba.tracing.kernel.intersector import query_ray
from sarmitsuba.tracing.kernel.launch import frame_towards, window_of
from sarmitsuba.tracing.kernel.scene_tables import DIFFUSE_NODES, MATERIAL_MASK, TraceScene
from sarmitsuba.tracing.kernel.table_rows import FaceRow, MaterialRow

# screen samples per resolution cell and axis
_SAMPLES_PER_CELL = 2.0
# sigma0 at normal incidence of surfaces in scenes where nothing scatters diffusely, dB
STAND_IN_DB = -15.0


class Raster:
    """Screen of parallel rays along one line of sight, projected onto an image grid.

    Parameters
    ----------
    sampling : plan of the run; gives the scene, its lit part and its resolution
    trace_scene : geometry
    grid : pixels
    range_window, azimuth_window : of the impulse response
    antenna : (3,) m, scene frame, antenna position; None: mid-aperture

    Notes
    -----
    Every screen sample adds ``sigma0 dA`` to the pixel of its range and along-track position; the sums are blurred
    with the squared impulse response and multiplied by a random field of unit mean power with the response's
    spectrum. Ignores multiple bounces, the coherent return of smooth surfaces, the antenna's pattern (the image is
    calibrated for it), the spread of looks over the aperture, and tracks that climb or turn.
    """

    def __init__(
        self,
        sampling: SamplingPlan,
        trace_scene: TraceScene,
        grid: ImageGrid,
        range_window: str = "rectangular",
        azimuth_window: str = "rectangular",
        antenna: F64 | None = None,
    ) -> None:
        scene, window = sampling.scene, sampling.window
        self.antenna, self.frame = scene.radar.track.center_position, window.frame
        half_x, half_y = window.half_x + window.taper, window.half_y + window.taper
        if antenna is not None:
            self.antenna = antenna
            self.frame = frame_towards(antenna[None], window.center, scene.radar.track.along)
            corners = np.array(np.meshgrid(*window.box.T)).reshape(3, -1).T
            spans = np.abs(window_of(corners, antenna, self.frame)).max(axis=0) + window.taper
            half_x, half_y = float(spans[0]), float(spans[1])
        self.scene, self.trace_scene, self.grid, self.window = scene, trace_scene, grid, window
        self.windows = (parse_window(range_window), parse_window(azimuth_window))
        finest = min(sampling.range_cell, sampling.azimuth_cell) / _SAMPLES_PER_CELL
        self.spacing = max(scene.settings.ray_spacing, finest)
        self.columns = int(np.ceil(2.0 * half_x / self.spacing))
        self.rows = int(np.ceil(2.0 * half_y / self.spacing))
        self.notes: list[str] = []
        self.table = trace_scene.diffuse_table
        used = [scene.materials[i] for i in sorted(set(scene.geometry.face_material.tolist()))]
        if not any(m.scatters for m in list_with_parts(used) if not m.invisible):
            self.table = self._stand_in()
        self.start = (-0.5 * (self.columns - 1) * self.spacing, -0.5 * (self.rows - 1) * self.spacing)

    @property
    def n_rays(self) -> int:
        """Number of samples of the screen."""
        return self.columns * self.rows

    def _stand_in(self) -> mi.Float:
        """Diffuse table of Lambert's law, for scenes of smooth surfaces only, which otherwise would have no echo."""
        text = (
            f"{self.scene.name}: method raster: no material scatters diffusely, so every surface is given Lambert's "
            f"law of {STAND_IN_DB:g} dB; give materials a diffuse_law, or use method image"
        )
        self.notes.append(text)
        warnings.warn(text, SarmitsubaWarning, stacklevel=4)
        theta = np.linspace(0.0, 0.5 * np.pi, DIFFUSE_NODES)
        one = amplitude_from_db(STAND_IN_DB) * np.cos(theta)
        table = np.broadcast_to(
            one[None, :, None], (len(list_with_parts(self.scene.materials)), DIFFUSE_NODES, 2)
        )
        return device_array(mi.Float, np.asarray(table, dtype=np.float32))

    def run(self, flags: KernelFlags, cell_azimuth: float) -> C64:
        """Complex image, (n_channels, n_azimuth, n_range) complex64; ``cell_azimuth``: resolution, m."""
        power = self.power(flags)
        scene, grid = self.scene, self.grid
        cell_range = scene.radar.waveform.range_cell
        if grid.kind == "ground":
            cell_range = cell_range / np.sin(self.window.incidence)
        cells = (cell_azimuth / self.windows[1].broadening, cell_range)
        spectra = [
            _band(n, spacing / cell, window)
            for n, spacing, cell, window in zip(
                grid.shape,
                (grid.azimuth_spacing, grid.range_spacing),
                cells,
                (self.windows[1], self.windows[0]),
                strict=True,
            )
        ]
        blur = np.outer(
            *(scipy.fft.fft(np.abs(scipy.fft.ifft(s) * s.size / s.sum()) ** 2).real for s in spectra)
        )
        blur = blur.astype(np.float32)
        out = np.empty((len(power), *grid.shape), dtype=np.complex64)
        rng = np.random.default_rng([scene.settings.seed, 0x7261737465])
        for i, plane in enumerate(power):
            smooth = scipy.fft.ifft2(scipy.fft.fft2(plane, workers=-1) * blur, workers=-1).real
            amplitude = np.sqrt(np.maximum(smooth, 0.0))
            out[i] = amplitude * _speckle(rng, spectra) if flags.speckle else amplitude
        return out

    def power(self, flags: KernelFlags) -> F32:
        """Sum of sigma0 dA over each pixel's samples, (n_channels, n_azimuth, n_range) float32, m^2."""
        scene, window, grid = self.trace_scene, self.window, self.grid
        f32 = mi.Float
        channels = self.scene.radar.channels

        # ---- screen
        lane = dr.arange(mi.UInt32, self.n_rays)
        row = lane // dr.opaque(mi.UInt32, self.columns)
        column = lane - row * dr.opaque(mi.UInt32, self.columns)
        gx = f32(column) * dr.opaque(f32, self.spacing) + dr.opaque(f32, self.start[0])
        gy = f32(row) * dr.opaque(f32, self.spacing) + dr.opaque(f32, self.start[1])
        antenna, frame = self.antenna, self.frame
        look = window.center - antenna
        look = look / np.linalg.norm(look)
        axis_x, axis_y, center, d = (
            _constant(v, mi.Vector3f, f32) for v in (frame.axis_x[0], frame.axis_y[0], window.center, look)
        )
        back = dr.opaque(f32, 4.0 * scene.extent + float(np.linalg.norm(window.center)))
        origin = center + axis_x * gx + axis_y * gy - d * back

        # ---- visible surface
        pi = scene.mi_scene.ray_intersect_preliminary(query_ray(origin, d), coherent=True)
        seen = pi.is_valid()
        p = origin + d * pi.t
        rows = pi.prim_index * 3
        wide = dr.float64_array_t(mi.Vector4f)
        normal = mi.Vector3f(*(f32(dr.gather(wide, scene.face_table, rows + i, seen)[3]) for i in range(3)))
        cosine = dr.maximum(dr.abs(dr.dot(normal, d)), 1e-3)
        own = FaceRow.of(scene.face_info, pi.prim_index, seen).material_bits
        level = f32(1.0)
        if flags.texture:
            seed = dr.opaque(mi.UInt32, self.scene.settings.seed & 0xFFFFFFFF)
            own, root = scene.at_place(pi.prim_index, own, mi.Vector3d(p), mi.Vector3d(normal), seed, seen)
            level = dr.square(root)
        material = own & MATERIAL_MASK

        # ---- sigma0 of the law at the local incidence angle
        area = dr.square(dr.opaque(f32, self.spacing)) * level / cosine
        amplitude = self._level(p, d, normal, cosine, material, seen)

        # ---- pixel of its range and along-track position, shared by four pixels
        x, y = self._pixel(mi.Vector3d(p) - _constant(antenna, mi.Vector3d, mi.Float64), antenna)
        n_azimuth, n_range = grid.shape
        inside = seen & (x >= 0.0) & (x < dr.opaque(mi.Float64, n_azimuth - 1))
        inside &= (y >= 0.0) & (y < dr.opaque(mi.Float64, n_range - 1))
        ix, iy = mi.UInt32(x), mi.UInt32(y)
        wx, wy = f32(x - dr.floor(x)), f32(y - dr.floor(y))

        on_cpu = dr.backend_v(f32) == dr.JitBackend.LLVM
        mode = dr.ReduceMode.Expand if on_cpu else dr.ReduceMode.Auto
        ratio = MaterialRow.of(scene.material_table, material, seen).cross_polar_ratio
        planes = []
        columns = dr.opaque(mi.UInt32, n_range)
        for channel in channels:
            # co-polar and cross-polar channels are uncorrelated for a reflection-symmetric surface
            power = f32(0.0)
            for factor, part in linear_parts(channel):
                co = amplitude.x * amplitude.x if part[0] == "H" else amplitude.y * amplitude.y
                if part[0] != part[1]:
                    co = amplitude.x * amplitude.y * ratio if flags.depolarisation else f32(0.0)
                power += co * abs(factor) ** 2
            plane = dr.zeros(f32, rounded_size(n_azimuth * n_range))
            for i, wi in enumerate((1.0 - wx, wx)):
                for j, wj in enumerate((1.0 - wy, wy)):
                    index = (ix + i) * columns + (iy + j)
                    dr.scatter_reduce(dr.ReduceOp.Add, plane, power * area * wi * wj, index, inside, mode)
            planes.append(plane)
        dr.eval(planes)
        return np.stack([plane.numpy()[: n_azimuth * n_range].reshape(grid.shape) for plane in planes])

    def _level(
        self,
        p: mi.Vector3f,
        d: mi.Vector3f,
        normal: mi.Vector3f,
        cosine: mi.Float,
        material: mi.UInt32,
        seen: mi.Bool,
    ) -> mi.Vector2f:
        """Square root of sigma0 for h and v at points (m) of the surface, tilted by waves where it is water."""
        f32, water = mi.Float, self.trace_scene.water
        if water is not None:
            lit = dr.select(dr.dot(normal, d) > 0.0, -normal, normal)
            cosine = dr.maximum(-dr.dot(water.tilt(lit, p, material, f32(0.0)), d), 1e-3)
        angle = dr.acos(dr.minimum(cosine, 1.0))
        theta = angle * ((DIFFUSE_NODES - 1) / (0.5 * np.pi))
        node = dr.minimum(mi.UInt32(theta), DIFFUSE_NODES - 2)
        entry = material * DIFFUSE_NODES + node
        low, high = (dr.gather(mi.Vector2f, self.table, entry + i, seen) for i in (0, 1))
        amplitude = low + (high - low) * (theta - f32(node))
        return amplitude if water is None else amplitude * water.level(material, angle, -2.0 * d)

    def _pixel(self, leg: mi.Vector3d, antenna: F64) -> tuple[mi.Float64, mi.Float64]:
        """Fractional pixel (azimuth, range), float64, of points at ``leg`` (Vector3d, m) from the antenna."""
        grid, f64 = self.grid, mi.Float64
        along = dr.dot(leg, _constant(grid.along, mi.Vector3d, f64))
        closest2 = dr.squared_norm(leg) - dr.square(along)
        offset = grid.origin - antenna
        drop = float(antenna[2] - grid.height)
        if grid.kind == "slant":
            across = dr.sqrt(closest2)
        else:
            across = dr.sqrt(dr.maximum(closest2 - dr.opaque(f64, drop**2), 0.0))
            across -= dr.opaque(f64, float(offset @ grid.across))
        x = (along - dr.opaque(f64, float(offset @ grid.along + grid.azimuth[0]))) * dr.opaque(
            f64, 1.0 / grid.azimuth_spacing
        )
        y = (across - dr.opaque(f64, float(grid.range[0]))) * dr.opaque(f64, 1.0 / grid.range_spacing)
        return x, y


def _constant(value: F64, vector: Any, scalar: Any) -> Any:
    return vector(*(dr.opaque(scalar, float(v)) for v in value))


def _band(n: int, share: float, window: Window) -> F64:
    """Window over the band on n FFT bins; ``share``: ratio of pixel spacing and resolution cell."""
    bins = scipy.fft.fftfreq(n) / share  # of the band, -1/2 ... 1/2
    return np.asarray(window(bins), dtype=np.float64)


def _speckle(rng: np.random.Generator, spectra: list[F64]) -> C64:
    """Circular complex Gaussian field of unit mean power with the spectrum of the impulse response."""
    shape = (spectra[0].size, spectra[1].size)
    white = rng.standard_normal((*shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
    white *= spectra[0][:, None].astype(np.float32)
    white *= spectra[1].astype(np.float32)
    power = np.sqrt(2.0 * np.mean(spectra[0] ** 2) * np.mean(spectra[1] ** 2) / white.size)
    return np.asarray(scipy.fft.ifft2(white, workers=-1, overwrite_x=True) / np.float32(power))
