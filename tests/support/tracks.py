"""Drawn errors of the track: their data, and scenes of metal trihedrals on clutter that a fit does not know."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba import FilmDescription, Material, RadarDescription, RawData, Scene, SceneMesh, build_scene
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.apps.fit.radar_parameters import AntennaTrack
from sarmitsuba.core.arrays import F64
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.settings import TraceSettings
from tests.support.fits import noisy

# trihedrals of a scene, their edge, m, and the reach of their places about the middle, m
TARGETS, EDGE, REACH = 8, 0.4, 0.38


@dataclass(frozen=True)
class TrackCase:
    """Data of a drawn track error.

    Parameters
    ----------
    scene : as a fit knows it, with the recorded track
    raw : echoes of the flown track, with the recorded one
    flown : (n_pulses, 3) m, true less recorded positions
    """

    scene: Scene
    raw: RawData
    flown: F64

    def along_sight(self, offsets: F64) -> F64:
        """Slant range to the middle of the scene that displacements (n_pulses, 3) add, m."""
        away = self.scene.radar.track.position - self.scene.radar.aim_point
        away = away / np.linalg.norm(away, axis=1, keepdims=True)
        return np.asarray((offsets * away).sum(axis=1))

    def on_track(self, offsets: F64) -> RawData:
        """The data with the recorded track displaced."""
        track = self.raw.radar.track
        moved = Track.from_samples(track.time, track.position + offsets)
        return replace(self.raw, radar=replace(self.raw.radar, track=moved))


def trihedral(place: Sequence[float], edge: float, toward: float) -> tuple[F64, F64]:
    """Vertices and faces of a triangular trihedral with its corner at ``place``, open to an azimuth, rad from +x."""
    c, s = np.cos(toward - 0.25 * np.pi), np.sin(toward - 0.25 * np.pi)
    axes = edge * np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    vertices = np.concatenate([np.zeros((1, 3)), axes]) + np.asarray(place, dtype=np.float64)
    return vertices, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]])


def targets(
    seed: int, *, extent: float, bandwidth: float, azimuth_resolution: float, pulses: int, level_db: float
) -> Scene:
    """Trihedrals on ground with a diffuse level, under an X-band spotlight radar without noise."""
    rng = np.random.default_rng([seed, 0x7A6])
    meshes = []
    for k, place in enumerate(rng.uniform(-REACH, REACH, (TARGETS, 2)) * extent):
        # the radar flies north in the west and looks east
        vertices, faces = trihedral([*place, 0.3], EDGE, np.pi + float(rng.uniform(-0.2, 0.2)))
        meshes.append(SceneMesh(vertices, faces, "pec", f"target{k}"))
    half = 0.75 * extent
    square = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    soil = Material(
        "soil", permittivity=5.0, diffuse_law="lambert", diffuse_level_db=level_db, rms_height=0.02
    )
    meshes.append(SceneMesh(square, np.array([[0, 1, 2], [0, 2, 3]]), soil, "ground"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return build_scene(
            meshes,
            radar=RadarDescription(
                mode="spotlight",
                slant_range=3000.0,
                look_angle_deg=float(rng.uniform(40.0, 50.0)),
                center_frequency=9.65e9,
                bandwidth=bandwidth,
                azimuth_resolution=azimuth_resolution,
                n_pulses=pulses,
                noise_temperature=0.0,
            ),
            film=FilmDescription(image_grid="slant", image_extent_azimuth=extent, image_extent_range=extent),
            settings=TraceSettings(
                method="hybrid",
                gridding_width=6,
                max_depth=3,
                endless_ground="off",
                effects={"diffuse_pairs": "off", "edge_diffraction": "off"},
            ),
            name=f"targets{seed}",
        )


def track_case(
    known: Scene, knots: int, wavelengths: float, seed: int, snr_db: float, real: Scene | None = None
) -> TrackCase:
    """A track whose knots are off by up to so many wavelengths along every axis, and its noisy data.

    ``real`` : scene whose echoes the data are, where the known one is only a part of it
    """
    scene = real or known
    model = ForwardModel(scene, parse(f"track:{knots}", scene))
    wavelength = scene.radar.waveform.wavelength
    truth = np.random.default_rng([seed, 0x7AC]).uniform(-1.0, 1.0, 3 * knots) * wavelengths * wavelength
    raw, _ = noisy(model.raw(model.data(truth)), snr_db, seed)
    return TrackCase(known, raw, track_offsets(scene, knots, truth))


def track_offsets(scene: Scene, knots: int, values: F64) -> F64:
    """(n_pulses, 3) displacement of the antenna, m, of the values of ``track:KNOTS``."""
    (track,) = parse(f"track:{knots}", scene)
    assert isinstance(track, AntennaTrack)
    return track.offsets(scene.radar.track.time, values)
