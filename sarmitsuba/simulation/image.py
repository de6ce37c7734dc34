"""The ladder of methods: one scene, one image grid, four ways to fill it, from interactive to exact.

``raster``: one bounce by projection, incoherent; ``image``: coherent multi-bounce paths of one look;
``hybrid``: raw data with paths shared by neighbouring pulses, focused; ``raw``: the same with every pulse traced.
"""

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.constants import SUBSET_SHARES
from sarmitsuba.echo.look_grid import LookGrid
from sarmitsuba.echo.noise import noise_power
from sarmitsuba.echo.raw import Layer
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.errors import RadarError, SceneError
from sarmitsuba.focusing import azimuth_cell, default_grid, focus
from sarmitsuba.focusing.aperture import CellPolynomial, incidence_angle, matched_weights
from sarmitsuba.focusing.look import Look, form_image, plan_look
from sarmitsuba.focusing.windows import parse_window
from sarmitsuba.image.sar_image import ImageGrid, SarImage
from sarmitsuba.progress import Progress, silent
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import METHODS
from sarmitsuba.simulation.pilot import plan_scene
from sarmitsuba.simulation.points import visible
from sarmitsuba.simulation.raster import Raster
from sarmitsuba.simulation.raw import Timer, TraceJob, TraceStatistics, simulate
from sarmitsuba.simulation.window import (
    RAYS_PER_WAVELENGTH,
    LaunchWindow,
    diffuse_spacing,
    launch_window,
    ray_lattices,
    ray_spacing,
)
from sarmitsuba.trace.geometry import TraceScene, build_trace_scene
from sarmitsuba.trace.launch import LaunchGrid
from sarmitsuba.trace.look_accumulator import ImageAccumulator

C64 = NDArray[np.complex64]

# automatic distance between the coherent rays of one look, in that of raw data: a third of the rays, for an error
# (-25.3 dB instead of -26.0 in Munich) that what changes over the aperture makes anyway
LOOK_SPACING = 2.0**0.75


def simulate_image(
    scene: Scene,
    *,
    method: str | None = None,
    grid: ImageGrid | None = None,
    range_window: str = "rectangular",
    azimuth_window: str = "rectangular",
    seed: int | None = None,
    plan: EffectsPlan | None = None,
    pass_index: int = 0,
    progress: Progress | None = None,
) -> SarImage:
    """Simulate the calibrated image of a scene with any method of the ladder.

    Parameters
    ----------
    scene : as loaded
    method : ``raster``, ``image``, ``hybrid`` or ``raw``; default: the scene's
    grid : pixels; default: those that the scene asks for, the same for every method
    range_window, azimuth_window : as for :func:`sarmitsuba.focusing.focus`
    seed : overrides the scene's
    plan : overrides the automatic effects plan
    pass_index : other values shift the ray lattices and nothing else
    progress : called after every batch

    Returns
    -------
    SarImage : the same grid, units and, but for ``raster``, phase from every method

    Raises
    ------
    RadarError
        When nothing comes back.

    Notes
    -----
    ``image`` ignores what changes over the aperture (visibility, specular glints, curvature of paths by several
    walls); ``raster`` also ignores every bounce after the first, the smooth part of surfaces, and phase: its speckle
    is a random field of the right statistics, not the scene's.
    """
    name = method or scene.settings.method
    if name not in METHODS:
        raise SceneError(f"{scene.name}: method {name!r} is unknown; choose one of {', '.join(METHODS)}")
    settings = replace(scene.settings, method=name)
    if seed is not None:
        settings = replace(settings, seed=seed)
    scene = replace(scene, settings=settings)
    grid = grid or default_grid(scene.radar, scene.image)
    windows: dict[str, Any] = {"range_window": range_window, "azimuth_window": azimuth_window}
    if name in ("image", "raster"):
        report = progress or silent
        preview = Preview(scene, grid, plan=plan, **windows)
        image = preview.image(pass_index) if name == "image" else preview.raster()
        report(name, 1.0, 1.0, {})
        return image
    raw = simulate(scene, plan=plan, pass_index=pass_index, progress=progress)
    start = time.perf_counter()
    image = focus(raw, grid, progress=progress or silent, **windows)
    seconds = {**raw.metadata["seconds"], "focus": time.perf_counter() - start}
    return replace(image, metadata={**image.metadata, "method": name, "seconds": seconds})


class Preview:
    """A scene made ready for the image-domain methods; each further image then takes a fraction of a second.

    Parameters
    ----------
    scene, grid, plan, range_window, azimuth_window : as for :func:`simulate_image`
    """

    def __init__(
        self,
        scene: Scene,
        grid: ImageGrid | None = None,
        *,
        plan: EffectsPlan | None = None,
        range_window: str = "rectangular",
        azimuth_window: str = "rectangular",
    ) -> None:
        self.timer = Timer()
        self.trace_scene: TraceScene | None = None
        self.job: TraceJob | None = None
        if scene.geometry.n_faces:
            self.trace_scene = build_trace_scene(
                scene.geometry, scene.materials, scene.radar.waveform.wavelength
            )
            self.timer.lap("build")
        self.plan = plan or plan_scene(scene, self.trace_scene)
        self.scene = scene = self.plan.apply(scene)
        self.grid = grid or default_grid(scene.radar, scene.image)
        self.windows = (range_window, azimuth_window)
        self.notes: list[str] = list(self.plan.notes)
        self.timer.lap("plan")
        if self.trace_scene is not None:
            window = launch_window(scene)
            # the image is calibrated for the pattern, so the look is taken without it
            flags = replace(
                self.plan.flags, antenna_pattern=False, taper=self.plan.flags.taper and window.taper > 0
            )
            self.plan = replace(self.plan, flags=flags)
            self.job = TraceJob(scene, self.plan, window, self.trace_scene, self.timer)
        self._look: Look | None = None
        self._raster: Raster | None = None
        self._rays: dict[int, tuple[LaunchGrid, ...]] = {}

    @property
    def look(self) -> Look:
        """Plan of the one look."""
        if self._look is None:
            # a cell less each way than raw data want: adding is most of the time, and -44 dB is below what one look
            # leaves out
            width = max(2, self.scene.settings.gridding_width - 1)
            self._look = plan_look(
                self.scene.radar,
                self.grid,
                range_window=self.windows[0],
                azimuth_window=self.windows[1],
                width=width,
            )
            self.timer.lap("plan")
        return self._look

    def image(self, pass_index: int = 0) -> SarImage:
        """Trace one look and form the image; see :func:`simulate_image`."""
        radar, settings, look = self.scene.radar, self.scene.settings, self.look
        orders = tuple(range(1, self.plan.max_depth + 1)) if settings.keep_orders else (0,)
        subsets = (1, 2) if settings.keep_subsets else (0,)
        channels = radar.channels
        layers = tuple(Layer(c, o, s) for s in subsets for o in orders for c in channels)
        planes: list[C64] = []
        stats = TraceStatistics()
        max_order = len(orders) if settings.keep_orders else 0
        for subset in subsets:
            cells = np.zeros(
                (len(orders) * len(channels), look.grid.n_range, look.grid.n_range_rate), np.complex64
            )
            if self.job is not None:
                accumulator = ImageAccumulator(
                    look.grid, len(orders), len(channels), max_order, radar.waveform.wavelength
                )
                stats = stats.plus(self._trace(accumulator, subset + 2 * pass_index, subset))
                cells = accumulator.grid()
            if self.scene.points:
                cells = cells + self._points(layers[: cells.shape[0]])
            planes.append(form_image(cells, look, radar) * np.float32(SUBSET_SHARES[subset]))
            self.timer.lap("form image")
        data = np.concatenate(planes)
        if not data.any():
            raise RadarError(
                f"{self.scene.name}: no echo of {stats.rays} rays falls into the image; check its centre and extents"
            )
        if self.plan.on("noise"):
            self._add_noise(data, layers)
            self.timer.lap("noise")
        return self._package(data, layers, "image", stats)

    def raster(self) -> SarImage:
        """Project the scene once; see :func:`simulate_image`."""
        if self.trace_scene is None or self.job is None:
            raise RadarError(
                f"{self.scene.name}: method raster needs a mesh; use method image for ideal points"
            )
        if self._raster is None:
            self._raster = Raster(self.scene, self.trace_scene, self.grid, self.job.window, *self.windows)
        cell = azimuth_cell_of(self.scene, self.grid, *self.windows)[0]
        self.timer.lap("plan")
        data = self._raster.run(self.plan.flags, cell)
        self.timer.lap("raster")
        layers = tuple(Layer(c) for c in self.scene.radar.channels)
        stats = TraceStatistics(rays=self._raster.n_rays, key_pulses=1)
        return self._package(data, layers, "raster", stats)

    def _trace(self, accumulator: ImageAccumulator, draw: int, subset: int) -> TraceStatistics:
        job, scene = self.job, self.scene
        assert job is not None
        if draw not in self._rays:
            self._rays[draw] = ray_lattices(
                look_sampling(scene, job.window, self.plan),
                job.window,
                self.plan.flags,
                draw=draw,
                subset=subset,
            )
            self.timer.lap("launch grid")
        look = accumulator.look
        total = TraceStatistics()
        for rays in self._rays[draw]:
            total = total.plus(
                job.launch(rays, look.position[None], look.velocity[None], slice(0, 1), accumulator, 1)
            )
        return total

    def _points(self, layers: tuple[Layer, ...]) -> C64:
        """Ideal points of the scene on the look's grid, co-polar layers of the first order only."""
        radar, grid = self.scene.radar, self.look.grid
        position = np.array([p.position for p in self.scene.points])
        leg = position - grid.position
        distance = np.linalg.norm(leg, axis=1)
        amplitude = np.array([np.sqrt(p.rcs) * np.exp(1j * p.phase) for p in self.scene.points])
        amplitude = amplitude * radar.amplitude_constant / distance**2
        if self.trace_scene is not None:
            amplitude = amplitude * visible(self.trace_scene, position, leg, distance)
        out = np.zeros((len(layers), grid.n_range, grid.n_range_rate), dtype=np.complex64)
        plane = spread_points(
            grid, distance, -(leg @ grid.velocity) / distance, amplitude, radar.waveform.wavelength
        )
        for i, layer in enumerate(layers):
            if layer.channel[0] == layer.channel[1] and layer.order in (0, 1):
                out[i] = plane
        return out

    def _add_noise(self, data: C64, layers: tuple[Layer, ...]) -> None:
        """Receiver noise as it comes out of the focuser: flat over the response's band."""
        radar, look = self.scene.radar, self.look
        power = noise_power(radar, "compressed")
        for index, channel in enumerate(radar.channels):
            own = [i for i, layer in enumerate(layers) if layer.channel == channel]
            lowest = min(layers[i].order for i in own)
            targets = [i for i in own if layers[i].order == lowest]
            rng = np.random.default_rng([self.scene.settings.seed, 0x6E6F697365, index])
            shape = (1, look.grid.n_range, look.grid.n_range_rate)
            white = rng.standard_normal((*shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
            noise = form_image(white, look, radar)[0] / look.gain
            noise *= (
                np.sqrt(power) * look.noise_gain / max(float(np.sqrt(np.mean(np.abs(noise) ** 2))), 1e-30)
            )
            for i in targets:
                data[i] += noise * look.gain * np.float32(SUBSET_SHARES[layers[i].subset])

    def _package(self, data: C64, layers: tuple[Layer, ...], method: str, stats: TraceStatistics) -> SarImage:
        radar = self.scene.radar
        cell, polynomial = azimuth_cell_of(self.scene, self.grid, *self.windows)
        broadening = parse_window(self.windows[0]).broadening
        middle = self.grid.positions_on_line(self.grid.azimuth.size // 2)
        self.timer.lap("calibrate")
        seconds, self.timer.seconds = self.timer.seconds, {}
        metadata: dict[str, Any] = {
            "scene": self.scene.name,
            "method": method,
            "settings": {k: v for k, v in vars(self.scene.settings).items() if k != "effects"},
            "effects": dict(self.plan.as_dict()),
            "plan": self.plan.summary(),
            "statistics": vars(stats),
            "image_request": dict(vars(self.scene.image)),
            "seconds": seconds,
            "focus": {
                "method": method,
                "range_window": self.windows[0],
                "azimuth_window": self.windows[1],
                "azimuth_cell_polynomial": polynomial,
                "center_position": [float(v) for v in radar.track.center_position],
            },
            "notes": [*self.scene.notes, *self.notes],
        }
        return SarImage(
            data=data,
            layers=layers,
            grid=self.grid,
            wavelength=radar.waveform.wavelength,
            azimuth_resolution_cell=cell,
            range_resolution_cell=radar.waveform.range_cell * broadening,
            incidence_angle=incidence_angle(radar, middle),
            metadata=metadata,
        )


def look_sampling(scene: Scene, window: LaunchWindow, plan: EffectsPlan) -> Scene:
    """The scene with the distance between one look's coherent rays where it does not set its own.

    Scenes small enough for several rays a wavelength keep them, and diffuse rays are as for raw data: wider ones would
    leave scatterer cells out.
    """
    if scene.settings.ray_spacing > 0.0 or not plan.flags.coherent:
        return scene
    spacing = ray_spacing(scene, window, False, True)
    if spacing <= 1.001 * scene.radar.waveform.wavelength / RAYS_PER_WAVELENGTH:
        return scene
    settings = replace(scene.settings, ray_spacing=LOOK_SPACING * spacing)
    if plan.flags.diffuse:
        settings = replace(settings, diffuse_ray_spacing=diffuse_spacing(scene, window))
    return replace(scene, settings=settings)


def azimuth_cell_of(
    scene: Scene, grid: ImageGrid, range_window: str, azimuth_window: str
) -> tuple[float, CellPolynomial]:
    """Noise-equivalent azimuth cell at the grid's centre, m, and its change over range, as the focuser states it."""
    radar = scene.radar
    middle = grid.positions_on_line(grid.azimuth.size // 2)
    range_cell = radar.waveform.range_cell * parse_window(range_window).broadening
    return azimuth_cell(
        radar,
        grid,
        middle,
        incidence_angle(radar, middle),
        lambda point: matched_weights(radar, point, azimuth_window),
        range_window,
        range_cell,
    )


def spread_points(
    grid: LookGrid,
    slant_range: NDArray[np.float64],
    rate: NDArray[np.float64],
    amplitude: NDArray[np.complex128],
    wavelength: float,
) -> C64:
    """Spread a few paths on a look's grid, (n_range, n_range_rate) complex64: ``ImageAccumulator`` in NumPy."""
    kernel = grid.kernel
    offset, x, y = grid.cells(slant_range, rate)
    inside = (x >= kernel.margin) & (x <= grid.n_range - 1 - kernel.margin)
    inside &= (y >= kernel.margin) & (y <= grid.n_range_rate - 1 - kernel.margin)
    x, y, offset, amplitude = x[inside], y[inside], offset[inside], amplitude[inside]
    value = amplitude * np.exp(-4j * np.pi / wavelength * offset)
    base_x, base_y = np.floor(x + kernel.shift), np.floor(y + kernel.shift)
    taps_x, taps_y = kernel.taps(x + kernel.shift - base_x), kernel.taps(y + kernel.shift - base_y)
    i, j = base_x.astype(int) - kernel.lead, base_y.astype(int) - kernel.lead
    out = np.zeros((grid.n_range, grid.n_range_rate), dtype=np.complex128)
    for p, tx in enumerate(taps_x):
        for q, ty in enumerate(taps_y):
            np.add.at(out, (i + p, j + q), value * tx * ty)
    return out.astype(np.complex64)


__all__ = ["Preview", "azimuth_cell_of", "look_sampling", "simulate_image", "spread_points"]
