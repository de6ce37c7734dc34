"""The one way from a scene to echoes and an image: plan, trace, add passes and noise, focus, account.

``raster``: one bounce by projection, incoherent; ``image``: coherent multi-bounce paths of one look;
``hybrid``: focused raw data, paths shared by neighbouring pulses; ``raw``: the same with every pulse traced.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import DataError, SceneError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.timing import Clock
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.radar.bursts import bursts_in_sight
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.scene.settings import METHODS, Method
from sarmitsuba.signal.focusing import focus
from sarmitsuba.signal.focusing.autofocus import Autofocuser
from sarmitsuba.signal.focusing.focuser import DEFAULT, Focuser
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.interference_filter import InterferenceFilter
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.mosaic import mosaic_bursts
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.error_bars import add_error_bars
from sarmitsuba.simulation.execution.fingerprint import fingerprint
from sarmitsuba.simulation.execution.finished import FinishedBlocks
from sarmitsuba.simulation.execution.image import Imager
from sarmitsuba.simulation.execution.passes import Refinement, refine
from sarmitsuba.simulation.execution.raw import echoes
from sarmitsuba.simulation.execution.run import Ready, Run
from sarmitsuba.simulation.execution.tracing import Workers


@dataclass(frozen=True, eq=False)
class RenderOptions:
    """Options of a simulation; None takes the value of the scene.

    Parameters
    ----------
    method : ``raster``, ``image``, ``hybrid`` or ``raw``
    seed : of every random number
    target_error_db : sampling error, energy over that of the image, up to which passes of rays are added; 0: one pass
    time_limit : s, for which passes are added; 0: no limit
    error_bars : keep two sets of rays, whose difference measures the sampling error
    grid : pixels
    focuser, range_window, azimuth_window, motion_compensation, autofocus, interference_filter : as for
        :func:`sarmitsuba.signal.focusing.focus`
    plan : overrides the automatic effects plan
    pass_index : other values shift the ray lattices only
    """

    method: Method | None = None
    seed: int | None = None
    target_error_db: float | None = None
    time_limit: float | None = None
    error_bars: bool | None = None
    grid: ImageGrid | None = None
    focuser: str | Focuser = DEFAULT
    range_window: str | Window = DEFAULT_WINDOW
    azimuth_window: str | Window = DEFAULT_WINDOW
    motion_compensation: str = "auto"
    autofocus: str | Autofocuser | None = None
    interference_filter: str | InterferenceFilter | None = None
    plan: EffectsPlan | None = None
    pass_index: int = 0

    def apply(self, scene: Scene) -> Scene:
        """The scene with these settings.

        Raises
        ------
        SceneError
            There is no such method.
        """
        given = {
            "method": self.method,
            "seed": self.seed,
            "target_error_db": self.target_error_db,
            "time_limit": self.time_limit,
            "keep_subsets": self.error_bars,
        }
        changes = {name: value for name, value in given.items() if value is not None}
        settings = replace(scene.settings, **changes) if changes else scene.settings  # type: ignore[arg-type]
        if settings.method not in METHODS:
            raise SceneError(
                f"{scene.name}: method {settings.method!r} is unknown{did_you_mean(settings.method, METHODS)}; "
                f"choose one of {', '.join(METHODS)}"
            )
        return replace(scene, settings=settings) if changes else scene


@dataclass(frozen=True, eq=False)
class Rendered:
    """Result of a simulation.

    Parameters
    ----------
    raw : echoes; None for methods without
    image : None where it was not asked for
    refinement : of a run that adds passes; None for one pass
    """

    raw: RawData | None
    image: SarImage | None
    refinement: Refinement | None = None


@exclusive
def execute(
    scene: Scene,
    options: RenderOptions,
    *,
    focused: bool = True,
    progress: Progress | None = None,
    ready: Ready | None = None,
    clock: Clock = time.perf_counter,
    state: Path | str | None = None,
    run_hash: str | None = None,
    workers: Workers | None = None,
) -> Rendered:
    """Simulate a scene and focus it: the same bits from the command line, Python and data sets.

    Parameters
    ----------
    scene : as loaded
    options : of the simulation and the image
    focused : whether an image is made; without, raw data alone
    progress, ready, clock, state, run_hash, workers : as for :func:`sarmitsuba.simulate`

    Returns
    -------
    Rendered

    Raises
    ------
    DataError
        Settings contradict each other.
    SceneError, RadarError, ResourceError, OutputError
        As for :func:`sarmitsuba.render`.
    """
    scene = options.apply(scene)
    scene.settings.check(scene.name, raw=not focused)
    if numbers := bursts_in_sight(scene.description, scene.radar, scene.image):
        if not focused:
            raise DataError(
                f"{scene.name}: raw data are those of one burst, and bursts {numbers[0]} to {numbers[-1]} light the "
                f"image; choose one, such as burst = {numbers[0]} of sar_antenna"
            )
        return _execute_bursts(scene, numbers, options, progress=progress, ready=ready, clock=clock)
    if scene.settings.adds_passes:
        if options.pass_index:
            raise DataError(
                f"{scene.name}: pass_index {options.pass_index} is of a single pass; leave out target_error_db and "
                "time_limit"
            )
        refined = refine(
            scene,
            state=state,
            grid=options.grid,
            range_window=str(options.range_window),
            azimuth_window=str(options.azimuth_window),
            progress=progress,
            ready=ready,
            clock=clock,
            workers=workers,
        )
        image = focus_echoes(refined.raw, options, progress) if focused else None
        return Rendered(refined.raw, image, refined)
    run = Run(scene, plan=options.plan, clock=clock, workers=workers)
    if state is not None and not scene.settings.one_look:
        run.finished = FinishedBlocks(
            state, run_hash or fingerprint(scene), run.plan, f"pass {options.pass_index}", run.batch_shape
        )
    try:
        traced = trace_run(run, options, progress=progress, ready=ready)
    finally:
        if run.finished is not None:
            run.finished.close()
    if isinstance(traced, SarImage):
        return Rendered(None, traced)
    if not focused:
        return Rendered(traced, None)
    with run.timer.stage("focus"):
        image = focus_echoes(traced, options, progress)
    facts = {"method": scene.settings.method, "seconds": dict(run.timer.seconds)}
    return Rendered(traced, replace(image, metadata={**image.metadata, **facts}))


def _execute_bursts(
    scene: Scene,
    numbers: Sequence[int],
    options: RenderOptions,
    *,
    progress: Progress | None,
    ready: Ready | None,
    clock: Clock,
) -> Rendered:
    """Run of every burst in sight, one after the other, and the mosaic of their images on the scene's grid."""
    grid = options.grid or default_grid(scene.radar, scene.image)
    images, radars = [], []
    for number in numbers:
        one = scene.replace(burst=str(number))
        done = execute(one, replace(options, grid=grid), progress=progress, ready=ready, clock=clock)
        assert done.image is not None
        images.append(done.image)
        radars.append(one.radar)
    return Rendered(None, mosaic_bursts(images, radars) if len(images) > 1 else images[0])


def trace_run(
    run: Run, options: RenderOptions, *, progress: Progress | None = None, ready: Ready | None = None
) -> RawData | SarImage:
    """Echoes of a planned run, or its image where the method makes no echoes."""
    settings, grid = run.scene.settings, options.grid
    # refusals of the method come before those for memory
    windows = [str(window) for window in (options.range_window, options.azimuth_window)]
    imager = (
        Imager(run, grid, range_window=windows[0], azimuth_window=windows[1]) if settings.one_look else None
    )
    run.admit(grid)
    if ready:
        ready(run)
    if imager is None:
        return echoes(run, pass_index=options.pass_index, progress=progress)
    image = imager.image(options.pass_index) if settings.method == "image" else imager.raster()
    (progress or silent)(settings.method, 1.0, 1.0, {})
    return add_error_bars(image)


def focus_echoes(raw: RawData, options: RenderOptions, progress: Progress | None = None) -> SarImage:
    """Image of simulated echoes, with its error bars."""
    image = focus(
        raw,
        options.grid,
        focuser=options.focuser,
        range_window=options.range_window,
        azimuth_window=options.azimuth_window,
        motion_compensation=options.motion_compensation,
        autofocus=options.autofocus,
        interference_filter=options.interference_filter,
        progress=progress or silent,
    )
    return add_error_bars(image)


@exclusive
def render(
    scene: SceneLike,
    *,
    radar: Path | str | None = None,
    parameters: Mapping[str, str] | None = None,
    ground: str | None = None,
    method: Method | None = None,
    seed: int | None = None,
    target_error_db: float | None = None,
    time_limit: float | None = None,
    error_bars: bool | None = None,
    grid: ImageGrid | None = None,
    focuser: str = DEFAULT,
    range_window: str = DEFAULT_WINDOW,
    azimuth_window: str = DEFAULT_WINDOW,
    motion_compensation: str = "auto",
    autofocus: str | Autofocuser | None = None,
    interference_filter: str | InterferenceFilter | None = None,
    plan: EffectsPlan | None = None,
    pass_index: int = 0,
    progress: Progress | None = None,
    ready: Ready | None = None,
    clock: Clock = time.perf_counter,
) -> SarImage:
    """Calibrated complex image of a scene, simulated and focused by any method.

    Parameters
    ----------
    scene : as loaded, a scene or mesh file, or the name of a shipped scene
    radar, parameters, ground : of a file or a name, as for :func:`sarmitsuba.load_scene`
    method : ``raster``, ``image``, ``hybrid`` or ``raw``; default: the scene's
    seed : of every random number; default: the scene's
    target_error_db, time_limit : passes of rays are added until the sampling error (energy over that of the image, dB)
        or the time (s) is reached; default: the scene's, 0 is one pass
    error_bars : keep two sets of rays, whose difference measures the sampling error; default: the scene's, which is on
    grid : pixels; default: those that the scene asks for, the same for every method
    focuser, range_window, azimuth_window, motion_compensation, autofocus, interference_filter : as for
        :func:`sarmitsuba.signal.focusing.focus`
    plan : overrides the automatic effects plan
    pass_index : other values shift the ray lattices only
    progress : called after every batch
    ready : called once the run is planned and fits into memory, before it is traced
    clock : of the stages' seconds in the metadata

    Returns
    -------
    SarImage : grid, units and (except for ``raster``) phase are the same for every method

    Raises
    ------
    SceneError
        There is no such method.
    DataError
        The method makes one pass, and passes are asked for.
    RadarError
        When no echo is received.
    ResourceError
        The run does not fit into memory.

    Notes
    -----
    For the limitations of ``image`` and ``raster`` see :class:`sarmitsuba.simulation.execution.image.Imager`.
    """
    scene = Scene.of(scene, radar=radar, parameters=parameters, ground=ground)
    options = RenderOptions(
        method=method,
        seed=seed,
        target_error_db=target_error_db,
        time_limit=time_limit,
        error_bars=error_bars,
        grid=grid,
        focuser=focuser,
        range_window=range_window,
        azimuth_window=azimuth_window,
        motion_compensation=motion_compensation,
        autofocus=autofocus,
        interference_filter=interference_filter,
        plan=plan,
        pass_index=pass_index,
    )
    image = execute(scene, options, progress=progress, ready=ready, clock=clock).image
    assert image is not None
    return image


@exclusive
def simulate(
    scene: SceneLike,
    *,
    radar: Path | str | None = None,
    parameters: Mapping[str, str] | None = None,
    ground: str | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
    plan: EffectsPlan | None = None,
    pass_index: int = 0,
    ready: Ready | None = None,
    clock: Clock = time.perf_counter,
    state: Path | str | None = None,
    run_hash: str | None = None,
    workers: Workers | None = None,
) -> RawData:
    """Raw data of a scene: the range-compressed echoes of every pulse.

    Parameters
    ----------
    scene : as loaded, a scene or mesh file, or the name of a shipped scene
    radar, parameters, ground : of a file or a name, as for :func:`sarmitsuba.load_scene`
    seed : overrides the scene's
    progress : called after every batch
    plan : overrides the automatic effects plan
    pass_index : other values shift the ray lattices only: independent samples of the same scene
    ready : called once the run is planned and fits into memory, before it is traced
    clock : of the stages' seconds in the metadata
    state : file of finished blocks of pulses, from which an interrupted run continues with the same bits; remove it
        when the data are stored. None: no file
    run_hash : hash of the blocks in ``state``; default: that of the scene, its settings and the program
    workers : workers that share the tracing, such as :class:`sarmitsuba.apps.cluster.DaskWorkers`; the
        result has the same bits

    Returns
    -------
    raw : ``compressed`` domain; one layer per channel, and per bounce order and ray subset where these are kept

    Raises
    ------
    DataError
        The method, ``image`` or ``raster``, makes no raw data.
    RadarError
        When no echo is received.
    ResourceError
        The run does not fit into memory.
    OutputError
        ``state`` cannot be written.

    Notes
    -----
    Limitations are those of the kernel; within a block of pulses amplitudes and visibility are those of its key pulse.
    """
    scene = Scene.of(scene, radar=radar, parameters=parameters, ground=ground)
    options = RenderOptions(seed=seed, plan=plan, pass_index=pass_index)
    given = {"progress": progress, "ready": ready, "clock": clock, "state": state, "run_hash": run_hash}
    raw = execute(scene, options, focused=False, workers=workers, **given).raw  # type: ignore[arg-type]
    assert raw is not None
    return raw
