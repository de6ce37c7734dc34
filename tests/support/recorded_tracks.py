"""Track of phase histories of others, fitted to corner reflectors at known places."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sarmitsuba import Fit, Prior, RadarDescription, RawData, Scene, SceneMesh, build_scene, fit
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.scene.settings import TraceSettings
from tests.support.tracks import track_offsets, trihedral

# standard deviation of positions known beforehand, m
KNOWN = 0.5


@dataclass(frozen=True)
class Corner:
    """Triangular trihedral: its corner, m in the frame of the data, its edge, m, and the azimuth it opens to, rad."""

    place: tuple[float, float, float]
    edge: float
    toward: float


@dataclass(frozen=True, eq=False)
class FittedTrack:
    """Fit of a track to corners.

    Parameters
    ----------
    fit : of the knots and the gain
    range_error : (n_pulses,) m, true minus recorded range to the middle of the corners
    level_db : by which the data were scaled before the fit
    """

    fit: Fit
    range_error: F64
    level_db: float


def read_targets(path: Path) -> list[Corner]:
    """Corners of a table: x, y, z, edge (m) and azimuth of the open side (degrees), separated by commas, one a line.

    Raises
    ------
    DataError : there is no such file, or lines of another number of columns
    """
    try:
        table = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: no table of corners: {error}") from None
    if table.shape[1] != 5:
        raise DataError(f"{path}: {table.shape[1]} columns; give x,y,z,edge,azimuth")
    return [Corner((x, y, z), edge, float(np.radians(toward))) for x, y, z, edge, toward in table]


def scene_of(raw: RawData, corners: Sequence[Corner]) -> Scene:
    """Corners alone under the radar of the data's first channel."""
    radar = replace(raw.radar, channels=raw.channels[:1])
    meshes = [
        SceneMesh(*trihedral(one.place, one.edge, one.toward), "pec", f"corner{k}")
        for k, one in enumerate(corners)
    ]
    described = RadarDescription(
        center_frequency=radar.waveform.center_frequency,
        bandwidth=radar.waveform.bandwidth,
        noise_temperature=0.0,
    )
    settings = TraceSettings(
        method="hybrid",
        gridding_width=6,
        max_depth=3,
        endless_ground="off",
        effects={"diffuse_pairs": "off", "edge_diffraction": "off"},
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = build_scene(meshes, radar=described, track=radar.track, settings=settings, name="corners")
    shift = scene.offset
    track = replace(radar.track, position=radar.track.position - shift)
    moved = replace(
        radar, track=track, aim_point=radar.aim_point - shift, offset=shift, noise_temperature=0.0
    )
    return replace(scene, radar=moved)


def fitted_to_targets(raw: RawData, corners: Sequence[Corner], knots: int) -> FittedTrack:
    """Fit of the track's knots and of the gain to the first channel of range-compressed data of unknown level."""
    channel = raw.channels[0]
    scene = scene_of(raw, corners)
    plane = raw.total(channel)
    expected = ForwardModel(scene, parse("gain", scene)).data()
    # the level is that of the ranges in which the corners are expected
    where = np.abs(expected[0]) > 0.1 * np.abs(expected).max()
    level = float(np.linalg.norm(expected[0][where]) / np.linalg.norm(plane[where]))
    data = replace(
        raw,
        data=(plane * np.float32(level))[None],
        layers=tuple(one for one in raw.layers if one.channel == channel)[:1],
        radar=scene.radar,
        autofocus_records={},
    )
    text = f"track:{knots},gain"
    names = ForwardModel(scene, parse(text, scene)).names
    priors = {name: Prior(0.0, KNOWN) for name in names if name.startswith("track")}
    found = fit(scene, data, text, priors=priors)
    away = scene.radar.track.position - np.mean([one.place for one in corners], axis=0) + scene.offset
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    offsets = track_offsets(scene, knots, found.values[:-1])
    return FittedTrack(found, np.asarray((offsets * away).sum(axis=1)), 20.0 * float(np.log10(level)))
