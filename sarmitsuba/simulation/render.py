"""Image of a scene by any of the four methods, from interactive to exact, on the same grid.

``raster``: one bounce by projection, incoherent; ``image``: coherent multi-bounce paths of one look;
``hybrid``: focused raw data, paths shared by neighbouring pulses; ``raw``: the same with every pulse traced.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from sarmitsuba.constants import DEFAULT_WINDOW
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.errors import SceneError
from sarmitsuba.exclusive import exclusive
from sarmitsuba.focusing import default_grid, focus
from sarmitsuba.focusing.focuser import DEFAULT
from sarmitsuba.image.sar_image import ImageGrid, SarImage
from sarmitsuba.progress import Progress, silent
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.scene.settings import METHODS, Method
from sarmitsuba.simulation.image import Imager
from sarmitsuba.simulation.raw import echoes
from sarmitsuba.simulation.refinement.error_bars import with_error_bars
from sarmitsuba.simulation.run import Ready, Run
from sarmitsuba.timing import Clock


@exclusive
def render(
    scene: SceneLike,
    *,
    radar: Path | str | None = None,
    parameters: Mapping[str, str] | None = None,
    ground: str | None = None,
    method: Method | None = None,
    seed: int | None = None,
    grid: ImageGrid | None = None,
    focuser: str = DEFAULT,
    range_window: str = DEFAULT_WINDOW,
    azimuth_window: str = DEFAULT_WINDOW,
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
    grid : pixels; default: those that the scene asks for, the same for every method
    focuser, range_window, azimuth_window : as for :func:`sarmitsuba.focusing.focus`
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
    RadarError
        When no echo is received.
    ResourceError
        The run does not fit into memory.

    Notes
    -----
    For the limitations of ``image`` and ``raster`` see :class:`sarmitsuba.simulation.image.Imager`.
    """
    scene = Scene.of(scene, radar=radar, parameters=parameters, ground=ground)
    name = method or scene.settings.method
    if name not in METHODS:
        raise SceneError(f"{scene.name}: method {name!r} is unknown; choose one of {', '.join(METHODS)}")
    settings = replace(scene.settings, method=name)
    if seed is not None:
        settings = replace(settings, seed=seed)
    run = Run(replace(scene, settings=settings), plan=plan, clock=clock)
    one_look = name in ("image", "raster")
    # refusals of the method come before those for memory
    imager = Imager(run, grid, range_window=range_window, azimuth_window=azimuth_window) if one_look else None
    run.admit(grid)
    if ready:
        ready(run)
    report = progress or silent
    if imager is not None:
        image = imager.image(pass_index) if name == "image" else imager.raster()
        report(name, 1.0, 1.0, {})
        return with_error_bars(image)
    raw = echoes(run, pass_index=pass_index, progress=progress)
    with run.timer.stage("focus"):
        image = focus(
            raw,
            grid or default_grid(scene.radar.as_recorded(), scene.image),
            focuser=focuser,
            range_window=range_window,
            azimuth_window=azimuth_window,
            progress=report,
        )
    image = replace(image, metadata={**image.metadata, "method": name, "seconds": dict(run.timer.seconds)})
    return with_error_bars(image)
