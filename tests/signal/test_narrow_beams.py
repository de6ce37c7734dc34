"""sigma0 of clutter that a beam of few azimuth cells lights, against sums over drawn scatterers in NumPy."""

import importlib

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import focus
from sarmitsuba.signal.focusing.aperture_weights import beam_over_cell, ground_cell_area, matched_weights
from sarmitsuba.simulation.execution.render import simulate

FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY
BAND = 3e8


def drawn(seed: int, cells: float, mode: str, prf: float = 0.0) -> tuple[Scene, np.ndarray]:
    """A radar whose half-power footprint is about so many azimuth cells wide, and a place in its image."""
    rng = np.random.default_rng([seed, 24])
    length = rng.uniform(1.5, 4.0)
    factor = rng.uniform(0.2, 0.7) if mode == "sliding_spotlight" else 1.0
    cell = 0.5 * factor * length * rng.uniform(0.8, 1.6)
    kind = str(rng.choice(["rectangular", "gaussian"]))
    width = {"antenna_length": length}
    if kind == "gaussian":
        width = {"azimuth_beamwidth_deg": float(np.degrees(0.886 * WAVELENGTH / length))}
    radar = RadarDescription(
        mode=mode,
        mode_parameters={"sliding_factor": factor} if mode == "sliding_spotlight" else {},
        slant_range=cells * cell * length / WAVELENGTH,
        look_angle_deg=rng.uniform(35.0, 55.0),
        squint_angle_deg=rng.uniform(-15.0, 15.0),
        heading_deg=rng.uniform(-180.0, 180.0),
        look_side=str(rng.choice(["left", "right"])),
        center_frequency=FREQUENCY,
        bandwidth=BAND,
        azimuth_resolution=cell,
        prf=prf,
        pattern=kind,
        elevation_beamwidth_deg=40.0,
        **width,
    )
    film = FilmDescription(image_extent_azimuth=8.0 * cell, image_extent_range=5.0)
    place = rng.uniform(-1.0, 1.0, 3) * [cell, cell, 0.0]
    return build_scene(points=[PointTarget("p", place, 1.0)], radar=radar, film=film), place


def mean_intensity(radar: Radar, place: np.ndarray, window: str, seed: int) -> float:
    """Of one pixel over unit clutter: scatterers drawn all over the beam, their phases averaged out, m^2.

    The range window is Hann's, whose side lobes end within the drawn strip.
    """
    reference = importlib.import_module("benchmarks.support.combinations_reference")
    rng = np.random.default_rng([seed, 25])
    wide, deep, n = 36.0, 6.0, (480, 24)
    foot = place - radar.track.center_position
    slant, ground = np.linalg.norm(foot), np.hypot(foot[0], foot[1])
    null = radar.antenna.nulls[0] * slant
    cell = WAVELENGTH * slant / (2.0 * np.linalg.norm(np.ptp(radar.track.position, axis=0)))
    half = np.array([min(2.5 * null, wide * cell), deep * 0.5 * SPEED_OF_LIGHT / BAND * slant / ground])
    # one in every box of a lattice, anywhere in it
    box = (
        np.stack(np.meshgrid(*(np.arange(m) for m in n), indexing="ij"), -1) + rng.uniform(size=(*n, 2))
    ) / n
    off = ((2.0 * box - 1.0) * half).reshape(-1, 2)
    out = foot[:2] / ground
    turn = off[:, 0] / ground
    radius = ground + off[:, 1]
    spread = np.stack(
        [
            radius * (out[0] * np.cos(turn) - out[1] * np.sin(turn)),
            radius * (out[1] * np.cos(turn) + out[0] * np.sin(turn)),
        ],
        axis=1,
    )
    points = np.concatenate([spread + radar.track.center_position[:2], np.zeros((len(spread), 1))], axis=1)

    axes = (radar.pointing.boresight, radar.pointing.azimuth_axis, radar.pointing.elevation_axis)
    numbers = reference.Numbers(
        radar.track.position,
        radar.track.position,
        radar.track.time,
        radar.track.velocity,
        *axes,
        FREQUENCY,
        BAND,
        radar.antenna.pattern,
        (radar.antenna.azimuth_beamwidth, radar.antenna.elevation_beamwidth),
        radar.half_aperture,
    )

    def seen(where: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        line = where[:, None] - radar.track.position
        distance = np.linalg.norm(line, axis=2)
        return distance, numbers.gain(line / distance[..., None])

    (here,), (gain,) = seen(place[None])
    weight = numbers.weights(place[None], window)[0]
    shape = reference.profile("hann")
    power = 0.0
    for some in np.array_split(points, 16):
        distance, gains = seen(some)
        beside = here - distance
        turned = np.exp(4j * np.pi / WAVELENGTH * beside) * shape(beside / (0.5 * SPEED_OF_LIGHT / BAND))
        power += float(np.sum(np.abs((gains * turned) @ (weight * gain)) ** 2))
    area = 4.0 * half[0] * half[1] / len(points) * np.mean(radius) / ground
    return power * area / float(np.sum(weight * gain**2)) ** 2


@pytest.mark.parametrize(
    ("seed", "cells"),
    [
        (1, 2.0),
        pytest.param(2, 6.0, marks=pytest.mark.slow),
        *(pytest.param(s, c, marks=pytest.mark.slow) for s in (3, 4, 5) for c in (1.5, 2.6, 4.0, 9.0)),
    ],
)
@pytest.mark.parametrize("mode", ["sliding_spotlight", pytest.param("stripmap", marks=pytest.mark.slow)])
def test_narrow_beams_keep_sigma0(mode: str, seed: int, cells: float) -> None:
    scene, place = drawn(seed, cells, mode)
    radar = scene.radar
    window = ("rectangular", "hamming", "taylor")[seed % 3]
    weights = matched_weights(radar, place, window)
    truth = mean_intensity(radar, place, window, seed)
    area = ground_cell_area(radar, place, weights, "hann")
    # tol: scatterers drawn one in a box, and the lattice's ends
    assert abs(10.0 * np.log10(area / truth)) < 0.05
    # what all clutter lit alike would give: the error that this is about
    alike = ground_cell_area(radar, place, weights, "hann", lit_alike=True)
    assert area / alike == pytest.approx(beam_over_cell(radar, place, weights))
    if cells < 2.1:
        assert 10.0 * np.log10(alike / truth) > 0.1


def test_a_wide_beam_changes_no_bit() -> None:
    scene, place = drawn(1, 60.0, "stripmap")
    weights = matched_weights(scene.radar, place)
    assert beam_over_cell(scene.radar, place, weights) == 1.0


def test_the_image_takes_it() -> None:
    # enough pulses that one more or less in a pixel's aperture is no step
    scene, _ = drawn(1, 2.0, "sliding_spotlight", prf=1000.0)
    image = focus(simulate(scene), request=scene.image, range_window="hann", azimuth_window="hamming")
    middle = tuple(n // 2 for n in image.grid.shape)
    place = image.grid.positions()[middle]
    area = ground_cell_area(scene.radar, place, matched_weights(scene.radar, place, "hamming"), "hann")
    # tol: the cubic over columns, where the range changes by a fifth over the image
    assert image.cell_area[middle] == pytest.approx(area, rel=6e-3)
