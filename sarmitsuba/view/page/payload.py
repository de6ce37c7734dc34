"""Content of a page: scene, radar passes and images; or target, RCS over aspect and image of an RCS sweep.

Labels are a number for the colour of each pixel, and shares. Side lobes of the impulse response tell a weak pixel from
the spill of a bright neighbour.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64, U8, unit_rows
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.mode import MODES
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image import ImageGrid, SarImage, backscatter
from sarmitsuba.signal.pixel_labels import LabelLayer, Labels
from sarmitsuba.simulation.execution.path_table import KINDS
from sarmitsuba.simulation.execution.rcs import target_middle
from sarmitsuba.simulation.execution.turntable import RcsSweep
from sarmitsuba.version import __version__
from sarmitsuba.view.display import has_clutter, limits_db
from sarmitsuba.view.page.gltf import PageMesh, draw_scene, page_mesh
from sarmitsuba.view.page.paths import PagePaths, page_paths
from sarmitsuba.view.page.quantised_profiles import page_grid, page_profiles
from sarmitsuba.view.page.run_folder import RunFolder
from sarmitsuba.view.polar import POLAR_FROM

PixelLabels = Mapping[str, str | Sequence[str] | Sequence[float] | NDArray[np.generic]]

# colours of the page; further codes, the least frequent ones, share the last
MOST_NAMES = 40
_OTHERS = "others"


def labels_payload(labels: Labels) -> list[PixelLabels]:
    """Layers of codes and of shares, ready for colouring.

    Returns
    -------
    for each layer ``name``, ``description``, ``names`` of the colours, most frequent first, ``share`` of the pixels
    that have each, and ``values`` (azimuth, range) uint8, place in ``names``. A layer of shares has in addition
    ``parts`` (azimuth, range, ``part_names``) uint8, in 1/255; its colour is that of the largest, and without any it is
    ``none``
    """
    found: list[PixelLabels] = []
    for name, layer in labels.layers.items():
        if layer.codes and not layer.parts and layer.values.dtype.kind in "iu":
            found.append(_pack_codes(name, layer))
        elif layer.parts and layer.unit in ("", "1") and layer.values.dtype.kind == "f":
            found.append(_pack_shares(name, layer))
    return found


def _pack_codes(name: str, layer: LabelLayer) -> PixelLabels:
    codes, inverse, count = np.unique(layer.values, return_inverse=True, return_counts=True)
    names = [layer.codes.get(int(code), str(code)) for code in codes]
    return _order_names(name, layer, names, inverse.reshape(layer.values.shape), count)


def _pack_shares(name: str, layer: LabelLayer) -> PixelLabels:
    shares = np.clip(np.nan_to_num(layer.values.astype(np.float64)), 0.0, 1.0)
    largest = np.where(shares.max(axis=2) > 0.0, shares.argmax(axis=2) + 1, 0)
    count = np.bincount(largest.reshape(-1), minlength=len(layer.parts) + 1)
    found = _order_names(name, layer, ["none", *layer.parts], largest, count)
    quantised: U8 = np.round(255.0 * shares).astype(np.uint8)
    return {**found, "part_names": list(layer.parts), "parts": quantised}


def _order_names(
    name: str,
    layer: LabelLayer,
    names: Sequence[str],
    places: NDArray[np.integer],
    count: NDArray[np.integer],
) -> PixelLabels:
    """Names in the order of their pixels, the rare ones as one."""
    order = np.argsort(-count, kind="stable")
    order = order[count[order] > 0]
    rank = np.zeros(len(names), dtype=np.uint8)
    rank[order] = np.minimum(np.arange(len(order)), MOST_NAMES - 1)
    shown = [names[i] for i in order[:MOST_NAMES]]
    share = (count[order] / max(int(count.sum()), 1)).tolist()
    if len(order) > MOST_NAMES:
        shown[-1] = _OTHERS
        share = [*share[: MOST_NAMES - 1], sum(share[MOST_NAMES - 1 :])]
    return {
        "name": name,
        "description": layer.description,
        "names": shown,
        "share": share,
        "values": rank[places],
    }


# cells along each axis over which side lobes are followed, and most pixels
_REACH, _MOST = 24.0, 160
# samples of a window, and of its transform in a cell
_SAMPLES, _FINE = 512, 32


def side_lobes(image: SarImage, range_window: str, azimuth_window: str) -> dict[str, NDArray[np.generic]]:
    """Greatest amplitudes of the impulse response so many pixels from its peak or further, relative to the peak.

    Parameters
    ----------
    image : of which the cells and the pixels count
    range_window, azimuth_window : with which it was focused

    Returns
    -------
    ``azimuth`` and ``range``, (n,) float32 from 0 pixels on, falling

    Notes
    -----
    The response is the product of the windows' transforms along the image's axes. Ignores squint, which turns the
    side lobes of range, and the shape of the band of wide apertures.
    """
    grid = image.grid
    range_cell = image.range_resolution_cell
    if grid.kind == "ground":
        range_cell /= float(np.sin(np.median(image.incidence_angle)))
    cells = {
        "azimuth": (image.azimuth_resolution_cell, grid.azimuth_spacing, azimuth_window),
        "range": (range_cell, grid.range_spacing, range_window),
    }
    return {
        name: _envelope(parse_window(text), cell, spacing).astype(np.float32)
        for name, (cell, spacing, text) in cells.items()
    }


def _envelope(window: Window, cell: float, spacing: float) -> F64:
    """Envelope at every pixel; ``cell`` is the noise-equivalent width."""
    own = cell / window.broadening  # the width without a window
    count = int(np.clip(np.ceil(_REACH * own / spacing), 1, _MOST))
    pixels = np.arange(count + 1)
    away = np.arange(0.0, (count + 1) * spacing / own + 2.0, 1.0 / _FINE)
    places = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    weights = window(places)
    response = np.abs(np.cos(2.0 * np.pi * np.outer(away, places)) @ weights) / weights.sum()
    falling = np.maximum.accumulate(response[::-1])[::-1]
    # the peak may be half a pixel nearer
    return np.asarray(np.interp(np.maximum(pixels - 0.5, 0.0) * spacing / own, away, falling))


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
            mesh = page_mesh(draw_scene(run.scene)[0], center)
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
    geometry, materials = draw_scene(scene)
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
        "pixels": nest_arrays(*page_grid(image.grid)),
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
        look["echo"] = nest_arrays(*page_profiles(run.raw, image.grid, name, **windows).payload())
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


def nest_arrays(header: Mapping[str, Value], arrays: Mapping[str, NDArray[np.generic]]) -> dict[str, Value]:
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
    line = unit_rows(line)
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


PAGE = "rcs.html"


def rcs_payload(scene: Scene, sweep: RcsSweep, image: SarImage | None) -> dict[str, Value]:
    """Content of the page of an RCS sweep.

    Parameters
    ----------
    scene : the target
    sweep : its RCS, shown unrounded
    image : made from the sweep's arc, with the same channels; None: no image
    """
    middle, radius = target_middle(scene)
    center = middle + scene.offset
    geometry, _ = draw_scene(scene)
    lowest = scene.geometry.bounds[0, 2] if scene.geometry.n_faces else middle[2] - radius
    angles = [np.degrees(sweep.aspects.azimuth), np.degrees(sweep.aspects.elevation)]
    by_elevation = not sweep.aspects.by_azimuth and angles[0].size > 1
    return {
        "title": scene.name,
        "version": __version__,
        "center": center,
        "radius": max(radius, 1e-3),
        "below": float(middle[2] - lowest),
        "scenes": [scene_payload(scene, page_mesh(geometry, center), center)],
        "frequency": sweep.frequency,
        "swept": "elevation" if by_elevation else "azimuth",
        "polar": bool(np.ptp(angles[by_elevation]) >= POLAR_FROM),
        "whole": sweep.aspects.whole_circle,
        "azimuth": angles[0],
        "elevation": angles[1],
        "channels": [_channel(sweep, name) for name in sweep.result.channels],
        "statement": {"text": sweep.statement.text, "warning": sweep.statement.warning},
        "image": None if image is None else _image(image, sweep, center),
    }


def _channel(sweep: RcsSweep, name: str) -> dict[str, Value]:
    """Curves of one polarisation, dB above 1 m^2, and the phase of their sum, deg."""
    i = sweep.result.channels.index(name)
    error = sweep.error_db[i]
    return {
        "name": name,
        "error": error if np.isfinite(error) else None,
        "total": sweep.dbsm(name),
        "phase": np.degrees(np.angle(sweep.total[:, i])),
        "orders": [{"order": order, "dbsm": sweep.dbsm(name, order)} for order in sweep.orders],
    }


def _image(image: SarImage, sweep: RcsSweep, center: F64) -> dict[str, Value]:
    """Image of every channel; axes from the target's centre, or x and y of the file for a full circle."""
    grid = image.grid.in_frame(np.zeros(3))
    pixels = nest_arrays(*page_grid(image.grid))
    origin = grid.origin * [1.0, 1.0, 0.0] - (0.0 if sweep.aspects.whole_circle else center)
    pixels["azimuth"] = grid.azimuth + float(origin @ grid.along)
    pixels["range"] = grid.across_distance() + float(origin @ grid.across)
    return {
        "grid": grid_payload(grid, center),
        "pixels": pixels,
        # radar cross section of points, not sigma0 of areas
        "channels": [image_payload(image, name) | {"cell_area": None} for name in sweep.result.channels],
    }
