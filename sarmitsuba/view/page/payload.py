"""Content of a page: scene, radar passes and images."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.mode import MODES
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image.calibration import backscatter
from sarmitsuba.signal.image.sar_image import ImageGrid, SarImage
from sarmitsuba.simulation.execution.path_table import KINDS
from sarmitsuba.version import __version__
from sarmitsuba.view.display import has_clutter, limits_db
from sarmitsuba.view.page.gltf import PageMesh, drawn, page_mesh
from sarmitsuba.view.page.labelled_pixels import labels_payload
from sarmitsuba.view.page.paths import PagePaths, page_paths
from sarmitsuba.view.page.quantised_profiles import page_grid, page_profiles
from sarmitsuba.view.page.run_folder import RunFolder
from sarmitsuba.view.page.side_lobes import side_lobes

# text, numbers and arrays, nested; arrays are stored as binary
Value = Mapping[str, "Value"] | Sequence["Value"] | NDArray[np.generic] | str | int | float | bool | None
# receives progress messages
Say = Callable[[str], None]

# value of the strongest pixel in the stored image: float16 then has full precision down to 140 dB below it
STORED_PEAK = 1024.0


def page_payload(runs: Sequence[RunFolder], channel: str | None, say: Say) -> dict[str, Value]:
    """Content of the page of one or several runs.

    Parameters
    ----------
    runs : one radar pass each; the first is shown first
    channel : polarisation shown; None: the first of each run
    say : receives progress messages
    """
    grid = runs[0].image.grid.in_frame(np.zeros(3))
    center = grid.positions_on_line(grid.shape[0] // 2)[grid.shape[1] // 2]
    scenes: list[Value] = []
    meshes: dict[bytes, int] = {}
    looks: list[Value] = []
    for run in runs:
        number: int | None = None
        if run.scene is not None:
            mesh = page_mesh(drawn(run.scene)[0], center)
            if mesh.glb not in meshes:
                meshes[mesh.glb] = len(scenes)
                scenes.append(scene_payload(run.scene, mesh, center))
            number = meshes[mesh.glb]
        looks.append({"scene": number, **_look(run, channel, center, say)})
    return {
        "title": runs[0].scene.name if runs[0].scene is not None else runs[0].path.name,
        "version": __version__,
        "center": center,
        "scenes": scenes,
        "looks": looks,
    }


def scene_payload(scene: Scene, mesh: PageMesh, center: F64) -> dict[str, Value]:
    """Geometry, materials and ideal points; positions relative to the page's origin."""
    geometry, materials = drawn(scene)
    return {
        "glb": np.frombuffer(mesh.glb, dtype=np.uint8),
        "faces": mesh.n_faces,
        "merged": mesh.merged,
        "meshes": geometry.mesh_names,
        "materials": list(materials),
        "ground": float(scene.geometry.ground_height + scene.offset[2] - center[2]),
        "points": [
            {"name": point.name, "position": point.position + scene.offset - center, "rcs": point.rcs}
            for point in scene.points
        ],
    }


def _look(run: RunFolder, channel: str | None, center: F64, say: Say) -> dict[str, Value]:
    """One radar pass with its image and paths."""
    image = run.image
    name = channel or image.channels[0]
    grid = image.grid.in_frame(np.zeros(3))
    windows = {
        key: str(image.metadata.get("focus", {}).get(key, "rectangular"))
        for key in ("range_window", "azimuth_window")
    }
    look: dict[str, Value] = {
        "name": run.path.name,
        "channel": name,
        "wavelength": image.wavelength,
        "grid": grid_payload(grid, center),
        "pixels": nested(*page_grid(image.grid)),
        "image": image_payload(image, name) | {"side_lobes": side_lobes(image, **windows)},
        "focus": str(image.metadata.get("focus", {}).get("method", image.metadata.get("method", ""))),
        "radar": None,
        "echo": None,
        "paths": None,
        "account": account_payload(run.account),
        "labels": None if run.labels is None else labels_payload(run.labels),
    }
    if run.raw is not None and run.raw.radar.start_stop().receiver is not None:
        say(f"{run.path}: bistatic data are not focused in the page")
    elif run.raw is not None:
        look["echo"] = nested(*page_profiles(run.raw, image.grid, name, **windows).payload())
    radar = run.raw.radar if run.raw is not None else None if run.scene is None else run.scene.radar
    if radar is not None:
        flown = run.raw.flown if run.raw is not None else None
        if flown is not None:
            radar = replace(radar, track=flown)
        look["radar"] = _radar(radar.in_file_frame(), grid, center)
    if run.scene is not None:
        say(f"{run.path}: tracing the paths behind the pixels")
        cell = (image.azimuth_resolution_cell, image.range_resolution_cell)
        if grid.kind == "ground":
            cell = (cell[0], cell[1] / float(np.sin(np.median(image.incidence_angle))))
        paths = page_paths(run.scene, grid.in_frame(run.scene.offset), cell, name, seed=run.seed)
        look["paths"] = _paths(paths, run.scene, center, name)
    return look


def account_payload(account: Mapping[str, object]) -> Value:
    """Error by cause and time by stage from a record, which may be anybody's: numbers and names only; None: none.

    Parameters
    ----------
    account : ``errors`` and ``account`` of parameters.json
    """
    errors, found = account.get("errors"), account.get("account")
    if not isinstance(errors, Mapping) or not isinstance(found, Mapping):
        return None
    stages, advice = found.get("stages"), found.get("advice")
    return {
        "total_db": _finite(found.get("total_db")),
        "known": str(found.get("known", "")),
        "errors": [
            {
                "name": str(name),
                "error_db": _finite(part.get("error_db")),
                "likely_db": _finite(part.get("likely_db")),
                "known": str(part.get("known")),
                "samples": _finite(part.get("samples")),
                "law_db": _finite(part.get("law_db")),
                "contradicts": part.get("contradicts") is True,
            }
            for name, part in errors.items()
            if isinstance(part, Mapping)
        ],
        "stages": [
            {
                "name": str(name),
                "seconds": _finite(time.get("seconds")),
                "processor": _finite(time.get("processor_seconds")),
            }
            for name, time in (stages.items() if isinstance(stages, Mapping) else ())
            if isinstance(time, Mapping)
        ],
        "advice": [str(text) for text in advice] if isinstance(advice, list) else [],
    }


def _finite(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else None


def grid_payload(grid: ImageGrid, center: F64) -> dict[str, Value]:
    """Axes of an image's grid; positions relative to the page's origin."""
    return {
        "kind": grid.kind,
        "shape": grid.shape,
        "azimuth": (float(grid.azimuth[0]), grid.azimuth_spacing),
        "range": (float(grid.range[0]), grid.range_spacing),
        "origin": grid.origin - center,
        "along": grid.along,
        "across": grid.across,
        "height": grid.height - float(center[2]),
    }


def image_payload(image: SarImage, channel: str) -> dict[str, Value]:
    """Complex layers per bounce order, or one of all orders (0), as float16 pairs of RCS amplitude times ``scale``.

    The levels of black and white are those of the picture of the image, dB.
    """
    orders: dict[int, C64] = {}
    for layer, plane in zip(image.layers, image.data, strict=True):
        if layer.channel == channel:
            orders[layer.order] = orders.get(layer.order, np.zeros_like(plane)) + plane
    if not orders:
        image.total(channel)  # raises an error that lists the channels
    peak = max(float(np.abs(plane).max()) for plane in orders.values())
    scale = STORED_PEAK / peak if peak > 0.0 else 1.0
    shown = db_from_power(backscatter(image, "sigma0" if image.calibrated else "rcs", channel))
    return {
        "scale": scale,
        "limits": limits_db(shown, clutter=has_clutter(image)),
        "cell_area": image.cell_area[image.grid.shape[0] // 2].astype(np.float32)
        if image.calibrated
        else None,
        "calibrated": image.calibrated,
        "resolution": (image.azimuth_resolution_cell, image.range_resolution_cell),
        "layers": [
            {
                "order": order,
                "re": (plane.real * scale).astype(np.float16),
                "im": (plane.imag * scale).astype(np.float16),
            }
            for order, plane in sorted(orders.items())
        ],
    }


def _radar(radar: Radar, grid: ImageGrid, center: F64) -> dict[str, Value]:
    """Track, beam and receive window; positions relative to the page's origin."""
    track, pointing, window = radar.track, radar.pointing, radar.window
    widths, beam = _beam(radar, grid)
    return {
        "mode": radar.mode,
        "mode_doc": MODES[radar.mode].doc if radar.mode in [mode.name for mode in MODES] else "",
        "side": radar.look_side,
        "frequency": radar.waveform.center_frequency,
        "bandwidth": radar.waveform.bandwidth,
        "time": track.time - track.time[0],
        "position": track.position - center,
        "velocity": track.velocity,
        "boresight": pointing.boresight.astype(np.float32),
        "azimuth_axis": pointing.azimuth_axis.astype(np.float32),
        "elevation_axis": pointing.elevation_axis.astype(np.float32),
        "beam_widths": widths,
        "beam": beam,
        "window": (float(window.start_range.min()), float(window.start_range.max()) + window.extent),
    }


def nested(header: Mapping[str, Value], arrays: Mapping[str, NDArray[np.generic]]) -> dict[str, Value]:
    """Numbers and arrays in one nested mapping; ``band.gap`` becomes ``gap`` within ``band``."""
    found: dict[str, dict[str, Value]] = {"": dict(header)}
    for name, array in arrays.items():
        inner, _, key = name.rpartition(".")
        if inner not in found:
            inside = header[inner]
            found[inner] = dict(inside) if isinstance(inside, Mapping) else {}
            found[""][inner] = found[inner]
        found[inner][key] = array
    return found[""]


def _beam(radar: Radar, grid: ImageGrid) -> tuple[tuple[float, float], str]:
    """Widths of the drawn beam cone, azimuth and elevation, rad, and their description."""
    antenna = radar.antenna
    if antenna.directive:
        return (antenna.azimuth_beamwidth, antenna.elevation_beamwidth), "antenna"
    middle = radar.track.center_index
    corners = grid.positions()[:: grid.shape[0] - 1 or 1, :: grid.shape[1] - 1 or 1].reshape(-1, 3)
    line = corners - radar.track.position[middle]
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    azimuth = 2.0 * float(np.abs(np.arcsin(line @ radar.pointing.azimuth_axis[middle])).max())
    elevation = 2.0 * float(np.abs(np.arcsin(line @ radar.pointing.elevation_axis[middle])).max())
    if np.isfinite(radar.half_aperture):
        return (2.0 * float(np.arcsin(min(radar.half_aperture, 1.0))), elevation), "processed"
    return (azimuth, elevation), "image"


def _paths(paths: PagePaths, scene: Scene, center: F64, channel: str) -> dict[str, Value]:
    """Paths with their points concatenated; path i has ``order[i]`` points."""
    table = paths.table
    there = np.isfinite(table.points[:, :, 0])
    points = table.points[there] + scene.offset - center
    return {
        "pulses": paths.pulses,
        "cell_size": paths.cell_size,
        "shape": paths.shape,
        "cell": paths.cell,
        "first": paths.first,
        "found": paths.found,
        "by_order": paths.by_order,
        "kinds": KINDS,
        "kind": table.kind,
        "order": table.order.astype(np.uint8),
        "pulse": table.pulse,
        "length": table.length,
        "amplitude": np.abs(table.amplitude[:, table.channels.index(channel)]).astype(np.float32),
        "share": paths.share,
        "points": points.astype(np.float32),
        "material": table.material[there].astype(np.int16),
        "mesh": table.shape[there].astype(np.int32),
    }
