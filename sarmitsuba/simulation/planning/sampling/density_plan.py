"""Sampling plan of a run: ray spacings, launch windows, scatterer cells and block length."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SUBSET_SHARES
from sarmitsuba.effects.context import SamplingFacts
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.block import choose_block_length
from sarmitsuba.signal.direct import box_slant_range
from sarmitsuba.simulation.planning.sampling import movers, water
from sarmitsuba.simulation.planning.sampling.double_bounce import steep_faces
from sarmitsuba.simulation.planning.sampling.launch_window import (
    LaunchWindow,
    bounding_antennas,
    launch_windows,
)
from sarmitsuba.simulation.planning.sampling.small_parts import expected_finer_rays
from sarmitsuba.tracing.kernel.launch import LATTICE_TURN, LaunchGrid, Purpose, lattice
from sarmitsuba.tracing.kernel.scene_tables import TraceScene

# rays per wavelength needed by curved and small parts (a sphere of ka = 60 is then within 0.1 dB of physical optics)
RAYS_PER_WAVELENGTH = 4.5
# rays of one pass up to which the whole window gets RAYS_PER_WAVELENGTH; beyond, tubes of several wavelengths serve
FINE_RAYS = 2_000_000
# footprint of a diffuse ray relative to the finer ground resolution: accuracy of shadow boundaries
FOOTPRINT_PER_RESOLUTION = 1.0 / 1.05
# diffuse scatterers per resolution cell and axis: their lattice is then not visible in mean clutter at any heading, nor
# on walls at any incidence
CELLS_PER_RESOLUTION = 1.4
# rad; wider apertures resolve less than half a wavelength, finer than the roughness of surfaces: the density of
# scatterers does not increase beyond
WIDEST = 1.0
# automatic coherent ray spacing of one look relative to raw data: a third of the rays, for a small increase of the
# error (-25.3 dB instead of -26.0 in Munich)
LOOK_SPACING = 2.0**0.75
# rad; half the change of the phase over a tube within a block. Amplitudes are those of the middle pulse, and the return
# of an edge is inversely proportional to that phase
TUBE_PHASE_CHANGE = 0.4
# most pulses of a block: bounds its grid. The angle, and the error measured at block boundaries, end blocks before
LONGEST_BLOCK = 512
# most triangles of a scene for which the lattice is rotated away from their edges
MOST_FACES = 2000
# pulses per key pulse assumed in estimates
USUAL_INTERVAL = 100


@dataclass(frozen=True)
class RaySpacings:
    """Ray spacings: distances between neighbouring rays, all subsets together.

    Parameters
    ----------
    coherent : m, of the rays for coherent returns, or of all rays without coherent returns
    diffuse : m, of the rays for diffuse returns; 0 where all rays are for returns of one kind
    """

    coherent: float
    diffuse: float

    def at(self, factor: float) -> dict[str, float]:
        """Settings for ray spacings multiplied by ``factor``; none that changes no rays."""
        out = {"ray_spacing": factor * self.coherent}
        return out | ({"diffuse_ray_spacing": factor * self.diffuse} if self.diffuse else {})


@dataclass(frozen=True, eq=False)
class SamplingPlan:
    """Sampling plan of a scene.

    Parameters
    ----------
    scene : with the effects plan applied
    flags : of the trace kernel, with the kinds of return
    windows : lit part of the scene from every sector of the track, in turn
    azimuth_cell : m, azimuth resolution of the whole aperture at the image's centre
    scatterer_cell : m, edge of the cells with one persistent diffuse scatterer; independent of the look
    footprint_spacing : m, ray spacing for footprints as large as a resolution cell
    spacings : ray spacings, as set or automatic
    halvings : of the spacing of all rays, also of finer ones
    """

    scene: Scene
    flags: KernelFlags
    windows: tuple[LaunchWindow, ...]
    azimuth_cell: float
    scatterer_cell: float
    footprint_spacing: float
    spacings: RaySpacings
    halvings: int = 0

    @staticmethod
    def of(scene: Scene, flags: KernelFlags | None = None) -> "SamplingPlan":
        """Sampling plan for a scene and its kinds of return.

        Parameters
        ----------
        scene : with a mesh
        flags : kinds of return; None: coherent ones, and diffuse ones where a material has a diffuse law

        Raises
        ------
        RadarError
            When no geometry lies within the image's footprint.
        """
        if flags is None:
            rough = any(m.scatters for m in list_with_parts(scene.materials))
            flags = KernelFlags(channels=scene.radar.channels, diffuse=rough)
        windows = launch_windows(scene)
        window = _window_at(windows, scene.radar.track.center_index)
        azimuth = azimuth_cell(scene)
        range_cell = scene.radar.waveform.range_cell
        cell = scene.settings.scatterer_cell or _rounded_down(min(azimuth, range_cell) / CELLS_PER_RESOLUTION)
        ground = range_cell / max(np.sin(window.incidence), 0.05)
        footprint = _footprint_spacing(scene, window, FOOTPRINT_PER_RESOLUTION * min(azimuth, ground))
        spacings = _spacings(scene, flags, window, azimuth, footprint)
        return SamplingPlan(scene, flags, windows, azimuth, cell, footprint, spacings)

    @property
    def window(self) -> LaunchWindow:
        """Lit part of the scene from the middle of the track."""
        return self.window_at(self.scene.radar.track.center_index)

    def window_at(self, pulse: int) -> LaunchWindow:
        """Lit part of the scene from the sector of a pulse."""
        return _window_at(self.windows, pulse)

    @cached_property
    def box(self) -> F64:
        """Bounds of the lit part over all sectors, (2, 3) m, scene frame."""
        boxes = np.array([window.box for window in self.windows])
        return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])

    def obeying(self, scene: Scene, flags: KernelFlags) -> "SamplingPlan":
        """Plan of the same scene with decided effects; computed again where they change the track or shapes."""
        if scene.radar.track is not self.scene.radar.track or not scene.same_shapes(self.scene):
            return SamplingPlan.of(scene, flags)
        spacings = _spacings(scene, flags, self.window, self.azimuth_cell, self.footprint_spacing)
        return replace(self, scene=scene, flags=flags, spacings=spacings)

    def of_one_look(self) -> "SamplingPlan":
        """Plan for one look (method ``image``), with wider automatic spacing of coherent rays.

        Scenes small enough for several rays per wavelength keep them, and diffuse rays are as for raw data: wider
        spacings would blur the edges of shadows.
        """
        if self.scene.settings.ray_spacing > 0.0 or not self.flags.coherent:
            return self
        if self.spacings.coherent <= 1.001 * self.fine_spacing:
            return self
        wider = replace(self.spacings, coherent=LOOK_SPACING * self.spacings.coherent)
        return replace(self, spacings=wider)

    @property
    def range_cell(self) -> float:
        """Slant-range resolution, m."""
        return self.scene.radar.waveform.range_cell

    @property
    def half_cell(self) -> float:
        """Half of the finer resolution, m: the largest automatic spacing of coherent rays."""
        return 0.5 * min(self.azimuth_cell, self.range_cell)

    @property
    def fine_spacing(self) -> float:
        """Ray spacing needed by curved and small parts, m."""
        return self.scene.radar.waveform.wavelength / RAYS_PER_WAVELENGTH

    @property
    def rays_per_pulse(self) -> int:
        """Estimated number of rays of all lattices of one pulse; diffuse rays only where their spacing is automatic."""
        rays = self.window.area / self.spacings.coherent**2
        both = self.flags.diffuse and self.flags.coherent
        if both and self.scene.settings.diffuse_ray_spacing == 0:
            rays += self.window.area / self.spacings.diffuse**2
        return int(rays)

    @property
    def expected_key_pulses(self) -> int:
        """Estimated number of traced pulses (:attr:`key_pulse_interval` is exact, but slow)."""
        n, settings = self.scene.radar.track.n_pulses, self.scene.settings
        by_method = {"raw": 1, "image": n, "raster": n}
        return -(-n // by_method.get(settings.method, settings.key_pulse_interval or USUAL_INTERVAL))

    @cached_property
    def key_pulse_interval(self) -> int:
        """Pulses that share one tracing: as set, or as many as the error of a block allows."""
        settings = self.scene.settings
        if settings.method == "raw":
            return 1
        return settings.key_pulse_interval or self.block_length(LONGEST_BLOCK)

    def block_length(self, longest: int) -> int:
        """Largest block length up to ``longest`` that the geometry of the track allows; 1 where none does.

        Tubes wider than automatic ones, half a resolution cell, count as these: whether their changing amplitudes
        matter beside the error of so few rays is measured while blocks are traced.
        """
        settings = self.scene.settings
        steady = self.steady_pulses(min(self.spacings.coherent, self.half_cell))
        length = choose_block_length(
            self.scene.radar,
            self.window.center,
            self.phase_box,
            settings.gridding_width,
            settings.tolerance_db,
            extra_slant_range=self.extra_slant_range,
            max_length=max(1, int(min(longest, steady))),
        )
        length = movers.block_length(
            self.scene, self.window.center, self.phase_box, length, self.extra_slant_range
        )
        if not self.flags.water_motion:
            return length
        return water.block_length(self.scene, self.window.center, length, every_beam=self.azimuth_later)

    @cached_property
    def azimuth_later(self) -> bool:
        """Whether the azimuth pattern can be applied in the synthesis, from the range rate of an echo."""
        if self.flags.motion:
            return False
        return not self.flags.water_motion or water.beam_tells(self.scene, self.window.center)

    def steady_pulses(self, width: float) -> float:
        r"""Number of pulses over which coherent tubes of a width, m, keep their amplitudes.

        The line of sight rotates by :math:`\lambda / 2 \delta_a` over the pulses of the azimuth resolution
        :math:`\delta_a`, and the phase over a tube of width d by :math:`4 \pi d / \lambda` times that.
        """
        if not self.flags.coherent:
            return float("inf")
        track, radar = self.scene.radar.track, self.scene.radar
        step = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
        if not step.size or not step.any():
            return float("inf")
        reach = np.linalg.norm(self.window.center - track.center_position)
        turn = radar.waveform.wavelength / (2.0 * self.azimuth_cell)
        per_pulse = np.pi * width / self.azimuth_cell * float(step.mean() / (reach * turn))
        return TUBE_PHASE_CHANGE / per_pulse

    @cached_property
    def kept(self) -> dict[tuple[str, KernelFlags], object]:
        """Lists that kinds of sources have found for this sampling; see ``Site.once``."""
        return {}

    @cached_property
    def phase_box(self) -> F64:
        """Bounds of the phase centres whose Doppler frequencies the grid represents, (2, 3) m.

        The lit box, a quarter more for mirror images, and at least the area lit by the rays' taper on level ground.
        """
        low, high = self.box
        fade = max(window.taper / max(float(np.cos(window.incidence)), 0.2) for window in self.windows)
        margin = np.maximum(0.25 * (high - low), fade) * np.array([1.0, 1.0, 0.0]) + 2.0 * self.scatterer_cell
        return np.stack([low - margin, high + margin])

    @cached_property
    def extra_slant_range(self) -> float:
        """Largest additional slant range by multiple reflections within the receive window, m."""
        window = self.scene.radar.window
        end = float(window.start_range.max()) + window.extent
        far = float(box_slant_range(self.phase_box, self.scene.radar, slice(None))[1].min())
        return max(0.0, end - far)

    @cached_property
    def extra_range_rate(self) -> float:
        """Largest change of a range rate by the motion of shapes and water, m/s."""
        fastest = movers.fastest(self.scene)
        return fastest + water.fastest(self.scene) if self.flags.water_motion else fastest

    def for_effects(self) -> SamplingFacts:
        """Quantities of the sampling used in the decisions on effects."""
        ground = self.range_cell / max(float(np.sin(self.window.incidence)), 0.05)
        return SamplingFacts(
            ray_spacing=self.spacings.coherent,
            n_rays=self.rays_per_pulse,
            cell=float(np.sqrt(self.azimuth_cell * ground)),
            box=self.box,
            key_pulses=self.expected_key_pulses,
            azimuth_cell=self.azimuth_cell,
            range_cell=self.range_cell,
        )

    def lattices(self, *, realisation: int = 0, subset: int = 0) -> tuple[LaunchGrid, ...]:
        """Ray lattices for each sector of the track.

        One lattice for all returns, or a separate coarser one for diffuse returns: these depend on the scatterer cells
        and hardly on the rays, so they need far fewer rays than coherent tubes.

        Parameters
        ----------
        realisation : number of the independent lattice (ray subsets, passes)
        subset : 1 and 2 divide the coherent rays by ``SUBSET_SHARES``; both have all diffuse rays, because footprints
            wider than a cell would blur the edges of shadows
        """
        return tuple(
            grid
            for purpose, spacing in self.purposes(subset)
            for grid in self._lattices(spacing, purpose, realisation)
        )

    def purposes(self, subset: int = 0) -> tuple[tuple[Purpose, float], ...]:
        """Kind of return and ray spacing, m, of each lattice of a ray subset."""
        sparser = float(1.0 / np.sqrt(SUBSET_SHARES[subset]))
        settings = self.scene.settings
        if self.flags.diffuse and not self.flags.coherent:
            return (("diffuse", self.spacings.coherent),)
        if not self.flags.diffuse:
            return (("coherent", sparser * self.spacings.coherent),)
        coherent, diffuse = sparser * self.spacings.coherent, self.spacings.diffuse
        if settings.ray_spacing > 0 and settings.diffuse_ray_spacing == 0:
            diffuse = max(diffuse, coherent / sparser)
        if 0.5 < diffuse / coherent < 1.25:  # a second launch would cost more than the few rays it saves
            return (("all", min(coherent, diffuse)),)
        return (("coherent", coherent), ("diffuse", diffuse))

    def finer_rays(self, scene: TraceScene, spacing: float, purpose: Purpose) -> int:
        """Estimated number of rays that finer lattices over small parts add to a plain one, see `with_small_parts`."""
        window, none = self.window, np.zeros(0, dtype=np.float32)
        grid = LaunchGrid(
            none, none, spacing, LATTICE_TURN, window.half_x, window.half_y, window.taper, purpose
        )
        antennas = bounding_antennas(self.scene.radar.track, window.pulses)
        return expected_finer_rays(grid, int(window.area / spacing**2), scene, window.frame, antennas)

    def _lattices(self, spacing: float, purpose: Purpose, realisation: int) -> tuple[LaunchGrid, ...]:
        """One lattice in the launch plane of every sector."""
        plain = (
            lattice(
                window.half_x,
                window.half_y,
                spacing,
                taper=window.taper,
                seed=self.scene.settings.seed,
                realisation=realisation,
                purpose=purpose,
                edges=self._edges(window) if purpose != "diffuse" else None,
            )
            for window in self.windows
        )
        return tuple(
            replace(grid, frame=window.frame, pulses=window.pulses)
            for grid, window in zip(plain, self.windows, strict=True)
        )

    def _edges(self, window: LaunchWindow) -> F64 | None:
        """Edges of the triangles in a launch plane, (n, 2) m; None in large scenes with edges in all directions."""
        geometry = self.scene.geometry
        if geometry.n_faces > MOST_FACES:
            return None
        corners = geometry.vertices[geometry.faces]
        edges = (np.roll(corners, -1, axis=1) - corners).reshape(-1, 3)
        axes = np.stack([window.frame.axis_x[0], window.frame.axis_y[0]], axis=1)
        return np.asarray(edges @ axes)


def azimuth_cell(scene: Scene) -> float:
    """Azimuth resolution cell lambda / (2 theta) of a pixel's aperture at the image centre, m.

    theta: rotation of the line of sight from the middle to both sides, up to ``WIDEST``.
    """
    track = scene.radar.track
    if np.isfinite(scene.radar.half_aperture):
        return float(scene.radar.waveform.wavelength / (4.0 * scene.radar.half_turn))
    middle = np.array([scene.image.center_x, scene.image.center_y, scene.image.height])
    line = track.position - middle
    reach = np.linalg.norm(line, axis=1, keepdims=True)
    line = line / np.maximum(reach, 1e-300)
    center = track.center_index
    # the cosine is inaccurate for small angles: use the sine
    sine = np.linalg.norm(np.cross(line, line[center]), axis=1)
    turn = np.arctan2(sine, line @ line[center])
    angle = min(float(turn[: center + 1].max() + turn[center:].max()), WIDEST)
    if track.n_pulses < 2 or angle == 0.0:
        return float(0.5 * (reach[0, 0] + reach[-1, 0]))
    return float(scene.radar.waveform.wavelength / (2.0 * angle))


def _window_at(windows: tuple[LaunchWindow, ...], pulse: int) -> LaunchWindow:
    return next(window for window in windows if window.pulses[0] <= pulse < window.pulses[1])


def _rounded_down(cell: float) -> float:
    """Largest power of the square root of two up to ``cell``: similar looks then have the same scatterers."""
    return float(2.0 ** (0.5 * np.floor(2.0 * np.log2(cell))))


def _footprint_spacing(scene: Scene, window: LaunchWindow, footprint: float) -> float:
    """Ray spacing for a given length of the footprint, m.

    The footprint is longest on level ground (over the cosine of the incidence angle) or, where the scene has any,
    on walls (over its sine).
    """
    steep, area = steep_faces(scene)
    slant = np.cos(window.incidence)
    if float(area[steep].sum()) > 0.01 * float(area.sum()):
        slant = min(slant, np.sin(window.incidence))
    return float(footprint * max(slant, 0.2))


def _spacings(
    scene: Scene, flags: KernelFlags, window: LaunchWindow, azimuth: float, footprint: float
) -> RaySpacings:
    """Ray spacings as set, or as the kinds of return need.

    Coherent tubes have ``RAYS_PER_WAVELENGTH`` up to ``FINE_RAYS`` rays, else a spacing of half a resolution cell.
    """
    settings = scene.settings
    diffuse = settings.diffuse_ray_spacing or footprint
    if settings.ray_spacing > 0:
        coherent = settings.ray_spacing
    elif flags.diffuse and not flags.coherent:
        coherent = diffuse
    else:
        coherent = scene.radar.waveform.wavelength / RAYS_PER_WAVELENGTH
        if window.area / coherent**2 > FINE_RAYS:
            half_cell = 0.5 * min(azimuth, scene.radar.waveform.range_cell)
            coherent = float(min(half_cell, np.sqrt(window.area / 1e5)))
    return RaySpacings(coherent, diffuse if flags.diffuse and flags.coherent else 0.0)
