"""Images without raw data: coherent multi-bounce paths of one look (``image``), or projection (``raster``)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT, SUBSET_SHARES
from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.timing import StageTimer
from sarmitsuba.core.witness import Witness
from sarmitsuba.radar.collection import flight_facts, signal_facts
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.aperture_weights import incidence_angle, matched_weights
from sarmitsuba.signal.focusing.cells import AzimuthCells, azimuth_cells, fit_columns
from sarmitsuba.signal.focusing.look import Look, form_image, plan_look
from sarmitsuba.signal.focusing.look_geometry import passing_time, sweeps
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.noise import noise_generator, noise_power
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.signal.sub_bands import RangeFilter, SubBands
from sarmitsuba.simulation.execution.blame import check_traced
from sarmitsuba.simulation.execution.error_bars import estimate_error, has_subsets
from sarmitsuba.simulation.execution.metadata import image_metadata
from sarmitsuba.simulation.execution.points import (
    PointEcho,
    PointLegs,
    PointTaps,
    build_legs,
    point_taps,
    takes_part,
)
from sarmitsuba.simulation.execution.raster import Raster
from sarmitsuba.simulation.execution.ray_witness import halved_plan, say_rays, witness_rays
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.execution.tracing import MAX_LANES, AntennaStates, Tracer, polarisation_up
from sarmitsuba.simulation.planning.prediction.counting import WITNESS_LEAST, WITNESS_SHARE
from sarmitsuba.simulation.planning.sampling.rays import check_small_parts
from sarmitsuba.tracing.kernel.accumulators import ImageAccumulator
from sarmitsuba.tracing.kernel.launch import LaunchGrid
from sarmitsuba.tracing.kernel.scene_tables import TraceScene
from sarmitsuba.tracing.kernel.source import Launch
from sarmitsuba.tracing.kernel.stage import stages_of

Filled = TypeVar("Filled", bound=ImageAccumulator)


class Imager:
    """Image-domain methods ``image`` and ``raster`` of a run; further images take a fraction of the time of the first.

    Parameters
    ----------
    run : prepared run
    grid : pixels; default: those that the scene asks for, the same for every method
    range_window, azimuth_window : as for :func:`sarmitsuba.signal.focusing.focus`

    Notes
    -----
    :meth:`image` ignores azimuth ambiguities and changes over the aperture (visibility, specular glints, range
    curvature of multi-bounce paths): moving objects are displaced by their range rate, but not defocused.
    :meth:`raster` also ignores every bounce after the first, the coherent return of surfaces, and phase: its speckle
    is a random field of the right statistics, not the speckle of the scene.
    """

    def __init__(
        self,
        run: Run,
        grid: ImageGrid | None = None,
        *,
        range_window: str = "rectangular",
        azimuth_window: str = "rectangular",
    ) -> None:
        if run.scene.radar.recorded is not None:
            raise RadarError(
                f"{run.scene.name}: methods image and raster make no raw data, so that a recorded track has no effect; "
                "take method raw or leave the track's errors out"
            )
        if run.scene.radar.recorded_pointing is not None:
            raise RadarError(
                f"{run.scene.name}: methods image and raster make no raw data, so that a pointing error has no effect; "
                "take method raw or leave it out"
            )
        if run.scene.radar.receiver is not None:
            raise RadarError(
                f"{run.scene.name}: methods image and raster look from one place, and the receiver is apart from the "
                "transmitter (bistatic); take method hybrid or raw"
            )
        if received := run.scene.radar.received:
            raise RadarError(
                f"{run.scene.name}: methods image and raster make no raw data, so that {received[0]} has no effect; "
                "take method hybrid or raw, or leave it out"
            )
        self.run = run
        grid = grid or default_grid(run.scene.radar, run.scene.image)
        self.grid = grid.in_frame(run.scene.radar.offset)
        self.windows = (range_window, azimuth_window)
        self.sampling = run.sampling.of_one_look() if run.sampling else None
        self._tracer: Tracer | None = None
        self._look: Look | None = None
        self._raster: Raster | None = None
        self._lattices: dict[int, list[tuple[LaunchGrid, ...]]] = {}

    @property
    def look(self) -> Look:
        """Plan of the looks.

        Raises
        ------
        DataError
            The impulse response varies too much over the image; the error names a method for this case.
        RadarError
            Something moves, and the beam passes over each pixel at another time.
        """
        if self._look is None:
            scene = self.run.scene
            look = plan_look(
                scene.radar,
                self.grid,
                range_window=self.windows[0],
                azimuth_window=self.windows[1],
                width=scene.settings.gridding_width,
            )
            if look.grid.fan is not None and scene.moves and self.run.plan.on("moving_targets"):
                raise RadarError(
                    f"{scene.name}: method image shows movement at one instant, and in mode {scene.radar.mode} the "
                    "beam passes over each place at another; take method hybrid, or set moving_targets off"
                )
            self._look = look
            self.run.timer.lap("plan")
        return self._look

    def image(self, pass_index: int = 0) -> SarImage:
        """Trace one look and form the image.

        Parameters
        ----------
        pass_index : other values shift the ray lattices only

        Raises
        ------
        RadarError
            When no echo is received.
        """
        run = self.run
        run.statistics, run.witnesses = TraceStatistics(), {}
        data = self._image_look(pass_index)
        if self.sampling is not None and (
            halved := halved_plan(self.sampling, self.rays(pass_index), run.witnesses.get("rays"))
        ):
            self.sampling, self._lattices = halved, {}
            data = self._image_look(pass_index)
        check_traced(data, 0.0, run.scene.name)
        if not data.any():
            raise RadarError(
                f"{run.scene.name}: none of {run.statistics.rays} rays returns an echo inside the image; check its "
                "centre and "
                "extents"
            )
        said = say_rays(run.scene.name, run.witnesses.get("rays"))
        run.notes += [said] if said and said not in run.notes else []
        if run.plan.on("noise"):
            self._add_noise(data, run.layers.layers)
            run.timer.lap("noise")
        return self.pack(data)

    def _image_look(self, pass_index: int) -> C64:
        """Pixels of all layers, without noise, and the witness of the rays in the run."""
        run, look = self.run, self.look
        radar, layers = run.scene.radar, run.layers
        planes: list[C64] = []
        seen: list[C64] = []
        for i, subset in enumerate(layers.subsets):
            cells = np.zeros((layers.per_subset, look.grid.n_range, look.grid.n_azimuth), np.complex64)
            if self.sampling is not None:
                cells = self._trace(self.rays(pass_index)[i])
            if run.scene.points:
                cells = cells + self._points(layers.layers[: layers.per_subset])
            seen.append(cells * np.float32(SUBSET_SHARES[subset]))
            planes.append(form_image(cells, look, radar) * np.float32(SUBSET_SHARES[subset]))
            run.timer.lap("form image")
        data = np.concatenate(planes)
        if self.sampling is not None:
            rays = self._witness(seen, data, pass_index)
            run.witnesses = {} if rays is None else {"rays": rays}
            run.timer.lap("trace")
        return data

    def _witness(self, seen: Sequence[C64], data: C64, pass_index: int) -> Witness | None:
        """Error of the rays, measured in the looks, see :mod:`.ray_witness`.

        Parameters
        ----------
        seen : echoes of every ray subset on the grid of the looks, weighted by its share
        data : the image's pixels
        """
        layers, before = self.run.layers, self.run.statistics
        own = [layer.channel for layer in layers.layers[: layers.per_subset]]

        def by_channel(cells: C64) -> C64:
            return np.stack([cells[[c == channel for c in own]].sum(axis=0) for channel in layers.channels])

        energy = np.square(np.abs(by_channel(np.sum(seen, axis=0))), dtype=np.float64).sum(axis=(1, 2))
        scatter = np.nan
        if has_subsets(layers.layers):
            scatter = max(estimate_error(data, layers.layers, pixels=False).error_db)
        assert self.sampling is not None
        scene, rays = self.run.scene, self.rays(pass_index)[0]
        cell = max(self.sampling.azimuth_cell, self.sampling.range_cell)
        seed, wavelength = scene.settings.seed, scene.radar.waveform.wavelength
        allowed = max(WITNESS_SHARE * (before.rays + before.contributions), WITNESS_LEAST)

        def traced(some: Sequence[LaunchGrid]) -> C64:
            return by_channel(self._trace(tuple(some), lambda launch: launch.part.rays > 0))

        found = witness_rays(traced, rays, energy, scatter, wavelength, cell, seed, allowed)
        self.run.statistics = before
        return found

    def pack(self, data: C64) -> SarImage:
        """Image of one look from its pixels (n_layers, n_azimuth, n_range)."""
        return self._package(data, self.run.layers.layers, "image", self._look_cells())

    def raster(self) -> SarImage:
        """Image by projection of the visible surface (one bounce, incoherent).

        Raises
        ------
        RadarError
            When the scene has no mesh.
        """
        run = self.run
        if run.trace_scene is None or run.sampling is None or not run.scene.geometry.n_faces:
            raise RadarError(
                f"{run.scene.name}: method raster draws surfaces, and the scene has none; add a mesh or use method "
                "image"
            )
        if run.scene.geometry.moves:
            raise RadarError(
                f"{run.scene.name}: method raster shows objects at rest only, and a mesh moves; take method image or "
                "hybrid, or set moving_targets off"
            )
        left_out = f"{run.scene.name}: method raster draws surfaces alone; wires, volumes and scatterers are left out"
        if run.scene.has_sources and left_out not in run.notes:
            run.notes.append(left_out)
        left = [stage.name for stage in stages_of(run.plan.flags) if stage.name in run.plan.flags.extra]
        if left:
            raise RadarError(
                f"{run.scene.name}: method raster traces no paths, so that {', '.join(left)} has no effect; take "
                f"method image or hybrid, or set {left[0]} off"
            )
        if self._raster is None:
            self._raster = Raster(
                run.sampling, run.trace_scene, self.grid, *self.windows, self._passing_antenna()
            )
        cell = self._middle_cells().center
        run.timer.lap("plan")
        data = self._raster.run(run.plan.flags, cell)
        check_traced(data, 0.0, run.scene.name)
        run.timer.lap("raster")
        layers = tuple(Layer(c) for c in run.scene.radar.channels)
        run.statistics = TraceStatistics(rays=self._raster.n_rays, key_pulses=1)
        return self._package(data, layers, "raster", self._raster_cells(cell))

    def rays(self, pass_index: int) -> list[tuple[LaunchGrid, ...]]:
        """Lattices of every ray subset at the middle of the track."""
        assert self.sampling is not None
        if pass_index not in self._lattices:
            middle = self.run.scene.radar.track.center_index
            every = self.run.lattices(self.sampling, pass_index)
            self._lattices[pass_index] = [
                tuple(grid for grid in grids if grid.serves(middle)) for grids in every
            ]
            if pass_index == 0:
                self.run.notes += check_small_parts(self.sampling, self.run.shortfalls)
        return self._lattices[pass_index]

    def _trace(
        self, rays: tuple[LaunchGrid, ...], wanted: Callable[[Launch], bool] = lambda launch: True
    ) -> C64:
        """Contributions of one ray subset on the grid of the looks; ``wanted``: launches that are traced."""
        run, grid = self.run, self.look.grid
        wavelength = run.scene.radar.waveform.wavelength

        def empty() -> ImageAccumulator:
            shape = len(run.layers.orders), len(run.layers.channels), run.layers.max_order
            return ImageAccumulator(grid, *shape, wavelength)

        cells: C64 | None = None
        for accumulator, share in self.launched(rays, empty, wanted=wanted):
            part = grid.filter_cells(np.asarray(accumulator.grid()), share, wavelength)
            cells = part if cells is None else cells + part
        assert cells is not None
        return cells

    @property
    def tracer(self) -> Tracer:
        """Tracer of the looks."""
        if self._tracer is None:
            assert self.sampling is not None
            # the image is corrected for the pattern, so the look is traced without it
            self._tracer = self.run.tracer(self.sampling, antenna_pattern=False)
        return self._tracer

    def launched(
        self,
        rays: tuple[LaunchGrid, ...],
        empty: Callable[[], Filled],
        term: int | None = None,
        wanted: Callable[[Launch], bool] = lambda launch: True,
    ) -> Iterator[tuple[Filled, RangeFilter | None]]:
        """Accumulators with the echoes of all looks, one for each traced frequency, and its share of the band.

        Parameters
        ----------
        rays : lattices
        empty : makes an accumulator
        term : see :class:`sarmitsuba.tracing.kernel.state.KernelSettings`
        wanted : launches to be traced
        """
        run, grid, time = self.run, self.look.grid, self.look.time
        with_numbers = self.tracer if term is None else self.tracer.of_term(term)
        most = max(1, MAX_LANES // max(lattice.n_rays for lattice in rays))
        together = min(most, grid.n_looks, self.tracer.most_pulses or grid.n_looks)
        for i, (tracer, share) in enumerate(with_numbers.over_band()):
            accumulator = empty()
            for first in range(0, grid.n_looks, together):
                pick = slice(first, min(first + together, grid.n_looks))
                tracer.pose(time[pick])
                accumulator.serve(pick.start, pick.stop)
                states = AntennaStates(grid.position[pick], grid.velocity[pick], slice(0, 1))
                for launch in filter(wanted, tracer.launches(rays, states.n_pulses)):
                    done = tracer.launch(launch, states, accumulator)
                    run.statistics = run.statistics.plus(done if i == 0 else replace(done, key_pulses=0))
            yield accumulator, share

    def _points(self, layers: tuple[Layer, ...]) -> C64:
        """Echoes of the ideal points on the grid of the looks, layers of the first order only."""
        grid, wave = self.look.grid, self.run.scene.radar.waveform
        out = np.zeros((len(layers), grid.n_range, grid.n_azimuth), dtype=np.complex64)
        for taps, share in self.point_taps([layer.channel for layer in layers]):
            part = np.zeros_like(out)
            for i, layer in enumerate(layers):
                if layer.order in (0, 1):
                    part[i] = taps.on(grid, taps.values[i])
            out += grid.filter_cells(part, share, wave.wavelength)
        return out

    def point_taps(self, channels: Sequence[str]) -> Iterator[tuple[PointTaps, RangeFilter | None]]:
        """Echoes of the ideal points in every channel given, at every frequency, with its share of the band."""
        grid, wave = self.look.grid, self.run.scene.radar.waveform
        there = self.run.trace_scene and self.run.trace_scene.at(float(self.look.time[0]))
        partly = takes_part(there, self.run.plan.flags)
        count = self.run.plan.sub_bands if partly else 1
        bands = SubBands(wave.center_frequency, wave.bandwidth, count)
        standing = build_legs(self.run.scene, there, bands)
        for index, at in enumerate(standing):
            wavelength = SPEED_OF_LIGHT / float(bands.frequencies[index])
            looks = [self._seen_points(channels, look, at, wavelength) for look in range(grid.n_looks)]
            yield PointTaps.joined(looks), bands.range_filter(index)

    def _seen_points(
        self, channels: Sequence[str], look: int, there: TraceScene | None, wavelength: float
    ) -> PointTaps:
        """Echoes of the ideal points in one look.

        Parameters
        ----------
        there : geometry that may occlude, at one frequency; moving objects are seen by one look only
        wavelength : m, at that frequency
        """
        radar, grid, flags = self.run.scene.radar, self.look.grid, self.run.plan.flags
        points, time = self.run.scene.points, np.asarray(self.look.time[look])
        position = np.array([p.position_at(time) for p in points])
        own = np.array([p.motion.velocity_at(time) for p in points])
        antenna, velocity = (
            np.broadcast_to(x, position.shape) for x in (grid.position[look], grid.velocity[look])
        )
        up = polarisation_up(radar, position[len(position) // 2], radar.track.center_position)
        legs = PointLegs.of(there, flags, wavelength, position, antenna, up)
        root = np.array([np.sqrt(p.rcs) * np.exp(1j * p.phase) for p in points], dtype=np.complex128)
        amplitude = radar.amplitude_constant * root
        echo = PointEcho.of([legs], amplitude, position, own, [(antenna, velocity)])
        echo = echo.through_stages(flags, wavelength, position)
        shown = np.array([echo.channel(channel) for channel in channels])
        return point_taps(grid, look, echo.slant_range, echo.range_rate, shown, radar.waveform.wavelength)

    def _add_noise(self, data: C64, layers: tuple[Layer, ...]) -> None:
        """Add receiver noise with the spectrum that focusing gives it: flat over the band of the impulse response."""
        radar, look, settings = self.run.scene.radar, self.look, self.run.scene.settings
        power = noise_power(radar, "compressed")
        for index, channel in enumerate(radar.channels):
            own = [i for i, layer in enumerate(layers) if layer.channel == channel]
            lowest = min(layers[i].order for i in own)
            targets = [i for i in own if layers[i].order == lowest]
            rng = noise_generator(radar, settings.seed, index, settings.pass_days)
            shape = (1, look.grid.n_range, look.grid.n_azimuth)
            white = rng.standard_normal((*shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
            noise = form_image(white, look, radar)[0] / look.gain
            noise *= (
                np.sqrt(power) * look.noise_gain / max(float(np.sqrt(np.mean(np.abs(noise) ** 2))), 1e-30)
            )
            for i in targets:
                data[i] += noise * look.gain * np.float32(SUBSET_SHARES[layers[i].subset])

    def _look_cells(self) -> AzimuthCells:
        """Resolution cells of the image: of every pixel's aperture, or of one response for all."""
        if self.look.grid.fan is None:
            return self._middle_cells()
        radar, window = self.run.scene.radar, self.windows[1]
        return self._cells(lambda p: matched_weights(radar, p, window))

    def _middle_cells(self) -> AzimuthCells:
        """Resolution cells of one response for all pixels, that of the image's centre."""
        radar, grid = self.run.scene.radar, self.grid
        middle = grid.positions_on_line(grid.shape[0] // 2)[grid.shape[1] // 2]
        weights = matched_weights(radar, middle, self.windows[1])
        return self._cells(lambda _: weights)

    def _cells(self, weights: Callable[[F64], F64]) -> AzimuthCells:
        """Resolution cells from pulse weights at positions (3,), m; without the antenna pattern."""
        return azimuth_cells(self.run.scene.radar, self.grid, weights, self.windows[0], lit_alike=True)

    def _passing_antenna(self) -> F64 | None:
        """Position of the antenna (3,), m, when its beam passes over the image's centre; None where it does not."""
        radar, grid = self.run.scene.radar, self.grid
        middle = grid.positions_on_line(grid.shape[0] // 2)[grid.shape[1] // 2]
        time = passing_time(radar, middle) if sweeps(radar) else None
        if time is None:
            return None
        return np.array([np.interp(time, radar.track.time, x) for x in radar.track.position.T])

    def _raster_cells(self, center: float) -> AzimuthCells:
        """Resolution cells of the raster: one response, with the range cell of closest approach or of the window."""
        assert self.run.sampling is not None
        grid, columns = self.grid, np.arange(self.grid.range.size)
        incidence = incidence_angle(self.run.scene.radar, grid.positions_on_line(grid.shape[0] // 2))
        to_ground = np.sin(
            self.run.sampling.window.incidence
        )  # ratio of the slant-range cell to its length on the ground
        if grid.kind == "slant":
            to_ground = grid.across_distance() / grid.range
        return AzimuthCells(*fit_columns(grid, columns, center * np.sin(incidence) / to_ground))

    def _package(self, data: C64, layers: tuple[Layer, ...], method: str, cells: AzimuthCells) -> SarImage:
        run = self.run
        radar = run.scene.radar
        broadening = parse_window(self.windows[0]).broadening
        middle = self.grid.positions_on_line(self.grid.azimuth.size // 2)
        run.timer.lap("calibrate")
        focus = {
            "method": method,
            "range_window": self.windows[0],
            "azimuth_window": self.windows[1],
            **cells.facts,
            "center_position": [float(v) for v in radar.track.center_position + radar.offset],
            **flight_facts(radar),
            **signal_facts(radar),
        }
        metadata = image_metadata(run, method, focus, self.sampling)
        run.timer = StageTimer(run.timer.clock)  # for the next image
        if self._tracer is not None:
            self._tracer.use_timer(run.timer)
        return SarImage(
            data=data,
            layers=layers,
            grid=self.grid,
            wavelength=radar.waveform.wavelength,
            azimuth_resolution_cell=cells.center,
            range_resolution_cell=radar.waveform.range_cell * broadening,
            incidence_angle=incidence_angle(radar, middle),
            metadata=metadata,
        )
