"""Adjoints of the synthesis of range profiles: the defining equation on drawn grids and profiles."""

from __future__ import annotations

import numpy as np
import pytest

from sarmitsuba import RadarDescription
from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal import block, block_synthesis, direct
from sarmitsuba.signal.sub_bands import SubBands

BOX = np.array([[-40.0, -60.0, 0.0], [40.0, 60.0, 12.0]])


def noise(rng: np.random.Generator, shape: tuple[int, ...]) -> C64:
    """Independent complex normal numbers."""
    return np.asarray(rng.standard_normal(shape) + 1j * rng.standard_normal(shape), dtype=np.complex64)


def drawn(rng: np.random.Generator, mode: str) -> Radar:
    """A drawn radar of 40 pulses."""
    from sarmitsuba import FilmDescription, Material, SceneMesh, build_scene

    corners = np.array([[-40.0, -40.0, 0.0], [40.0, -40.0, 0.0], [40.0, 40.0, 0.0], [-40.0, 40.0, 0.0]])
    soil = Material("soil", permittivity=5.0, diffuse_law="lambert", diffuse_level_db=-5.0)
    return build_scene(
        [SceneMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), soil, "ground")],
        radar=RadarDescription(
            slant_range=float(rng.uniform(1500.0, 6000.0)),
            look_angle_deg=float(rng.uniform(25.0, 55.0)),
            squint_angle_deg=float(rng.uniform(0.0, 15.0)) if mode == "spotlight" else 0.0,
            bandwidth=float(rng.uniform(60e6, 200e6)),
            mode=mode,
            n_pulses=40,
        ),
        film=FilmDescription(image_extent_azimuth=60.0, image_extent_range=60.0),
    ).radar


def inner(a: C64, b: C64) -> complex:
    """Sum of conj(a) b in double precision."""
    return complex(np.vdot(a.astype(np.complex128), b.astype(np.complex128)))


def filters(radar: Radar) -> list:
    """No filter, the share of one of three frequencies, and a complex one that grows with frequency."""
    wave = radar.waveform

    def slope(cycles: F64) -> C128:
        return np.asarray(-1j * (400.0 + 2.0 * np.pi * cycles), dtype=np.complex128)

    return [None, SubBands(wave.center_frequency, wave.bandwidth, 3).range_filter(2), slope]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
def test_adjoints_satisfy_their_equation(seed: int, mode: str) -> None:
    rng = np.random.default_rng([seed, len(mode)])
    radar = drawn(rng, mode)
    width = int(rng.integers(2, 8))
    plan = block.plan_block(radar, 3, 35, np.zeros(3), BOX, width)
    every = direct.plan_direct(radar, 3, 9, BOX, width)
    for share in filters(radar):
        x, y = noise(rng, plan.shape(2)), noise(rng, (2, 32, radar.window.n_samples))
        forward = block_synthesis.synthesise(x, plan, radar, beam=mode == "stripmap", share=share)
        back = block_synthesis.synthesise_adjoint(y, plan, radar, beam=mode == "stripmap", share=share)
        assert back.shape == x.shape and back.dtype == np.complex64
        size = float(np.linalg.norm(forward) * np.linalg.norm(y))
        # tol: float32 transforms, relative to the product of the norms
        assert abs(inner(y, forward) - inner(back, x)) < 1e-7 * size

        x, y = noise(rng, every.shape(2)), noise(rng, (2, 6, radar.window.n_samples))
        forward = direct.finish(x, every, radar, share=share)
        back = direct.finish_adjoint(y, every, radar, share=share)
        size = float(np.linalg.norm(forward) * np.linalg.norm(y))
        assert back.shape == x.shape
        assert abs(inner(y, forward) - inner(back, x)) < 1e-7 * size  # tol: as above
