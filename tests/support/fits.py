"""Fits to drawn raw data: material levels in noise, and tracks that are off by wavelengths."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sarmitsuba import (
    FilmDescription,
    Fit,
    Material,
    RadarDescription,
    RawData,
    Scene,
    SceneMesh,
    TraceSettings,
    build_scene,
    fit,
)
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import BOLTZMANN
from sarmitsuba.signal.noise import add_noise
from tests.support.differences import box as drawn_box

# pulses of a block: short ones, within which directions do not change
BLOCK = 8


def fields(seed: int, materials: int, pulses: int, *, box: bool = True, **radar: Any) -> Scene:
    """Fields of rough materials side by side, with a rough box, under a radar without noise.

    ``box`` : whether it is there; ``radar`` : values in place of the drawn ones
    """
    rng = np.random.default_rng([seed, 0xF17])
    levels = rng.uniform(-18.0, -6.0, materials + 1)
    edges = np.linspace(-12.0, 12.0, materials + 1)

    def rough(name: str, level: float) -> Material:
        return Material(
            name, permittivity=5.0, diffuse_law="lambert", diffuse_level_db=level, rms_height=0.02
        )

    meshes = []
    for i in range(materials):
        west, east = edges[i], edges[i + 1]
        corners = np.array([[west, -12.0, 0.0], [east, -12.0, 0.0], [east, 12.0, 0.0], [west, 12.0, 0.0]])
        triangles = np.array([[0, 1, 2], [0, 2, 3]])
        meshes.append(SceneMesh(corners, triangles, rough(f"field{i}", float(levels[i])), f"field{i}"))
    wall = SceneMesh(*drawn_box(rng, float(rng.uniform(0.0, 3.0))), rough("wall", float(levels[-1])), "box")
    given = {
        "slant_range": 3000.0,
        "look_angle_deg": float(rng.uniform(30.0, 50.0)),
        "center_frequency": 9.65e9,
        "bandwidth": 150e6,
        "n_pulses": pulses,
        "noise_temperature": 0.0,
    }
    return build_scene(
        [*meshes, wall] if box else meshes,
        radar=RadarDescription(**(given | radar)),
        film=FilmDescription(image_extent_azimuth=22.0, image_extent_range=22.0),
        settings=TraceSettings(
            method="hybrid",
            key_pulse_interval=BLOCK,
            gridding_width=6,
            max_depth=2,
            effects={"diffuse_pairs": "off"},
        ),
        name=f"fields{seed}",
    )


def noisy(raw: RawData, snr_db: float, seed: int) -> tuple[RawData, float]:
    """Raw data with noise of a ratio of mean powers, and the noise temperature, K."""
    power = float(np.mean(np.abs(raw.data) ** 2)) * 10.0 ** (-0.1 * snr_db)
    temperature = power * raw.radar.waveform.pulse_width / BOLTZMANN
    radar = replace(raw.radar, noise_temperature=temperature)
    return add_noise(replace(raw, radar=radar), seed=seed), temperature


def fitted_levels(scene: Scene, offsets: F64, snr_db: float, seeds: range) -> tuple[F64, list[Fit]]:
    """True levels of all materials, off by ``offsets`` (dB) from the scene's, and fits to data with drawn noise."""
    model = ForwardModel(scene, parse("levels", scene))
    truth = model.start + offsets
    raw = model.raw(model.data(truth))
    fits = []
    for seed in seeds:
        data, temperature = noisy(raw, snr_db, seed)
        radar = replace(scene.radar, noise_temperature=temperature)
        fits.append(fit(replace(scene, radar=radar), data, "levels"))
    return truth, fits


def fitted_track(scene: Scene, knots: int, wavelengths: float, seed: int, snr_db: float) -> tuple[F64, Fit]:
    """True displacements of a track, m, drawn up to so many wavelengths along every axis, and a fit to its data."""
    parameters = f"track:{knots}"
    model = ForwardModel(scene, parse(parameters, scene))
    wavelength = scene.radar.waveform.wavelength
    truth = np.random.default_rng([seed, 0x7AC]).uniform(-1.0, 1.0, 3 * knots) * wavelengths * wavelength
    data, _ = noisy(model.raw(model.data(truth)), snr_db, seed)
    return truth, fit(scene, data, parameters)


def range_error(scene: Scene, knots: int, wrong: F64) -> float:
    """Largest error along the line of sight of displacements that are wrong by ``wrong``, wavelengths."""
    (track,) = parse(f"track:{knots}", scene)
    radar = scene.radar
    away = radar.track.position / np.linalg.norm(radar.track.position, axis=1, keepdims=True)
    offsets = track.offsets(radar.track.time, wrong)  # type: ignore[attr-defined]
    return float(np.abs((offsets * away).sum(axis=1)).max() / radar.waveform.wavelength)
