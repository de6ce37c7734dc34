"""Polarimetric calibration recovers the distortion that was put in."""

import json
from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import PointTarget, RadarDescription, build_scene, cli, focus, simulate
from sarmitsuba.analysis.polarimetric_calibration import (
    CalibrationTarget,
    calibrate_polarimetry,
    read_targets,
    solve_distortion,
)
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.receive_chain import ReceiveChain
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.signal.receive import receive

QUAD = ("HH", "HV", "VH", "VV")
CORNERS = (
    CalibrationTarget("trihedral", (-6.0, -5.0, 0.0)),
    CalibrationTarget("dihedral", (5.0, -4.0, 0.0)),
    CalibrationTarget("dihedral", (1.0, 6.0, 0.0), np.radians(45.0)),
)


def _draw(rng):
    """Matrix with imbalance to 2 dB and 60 deg and cross-talk to -12 dB; HH is 1."""
    z = 0.25 * rng.uniform(size=2) * np.exp(2j * np.pi * rng.random(2))
    vv = 10.0 ** (rng.uniform(-2, 2) / 20.0) * np.exp(1j * rng.uniform(-1, 1))
    return np.array([[1.0, z[0]], [z[1], vv]])


def _text(matrix):
    return ",".join(f"{v.real:.17g}{v.imag:+.17g}j" for v in matrix.ravel())


@pytest.mark.parametrize("seed", range(8))
def test_drawn_radars_are_recovered(seed):
    rng = np.random.default_rng(seed)
    receiver, transmitter = _draw(rng), _draw(rng)
    ideal = np.array([target.matrix for target in CORNERS])
    factors = rng.uniform(0.1, 10.0, 3) * np.exp(2j * np.pi * rng.random(3))
    measured = factors[:, None, None] * (receiver @ ideal @ transmitter)
    found = solve_distortion(measured, ideal)
    # tol: the solver's steps
    assert np.allclose(found.receive, receiver, atol=1e-6)
    assert np.allclose(found.transmit, transmitter, atol=1e-6)
    assert np.allclose(found.factors, factors, rtol=1e-5)
    assert found.residual_db < -120.0


@pytest.mark.slow
def test_image_of_a_distorted_radar_is_calibrated(tmp_path):
    rng = np.random.default_rng(11)
    receiver, transmitter = _draw(rng), _draw(rng)
    radar = RadarDescription(
        slant_range=2e3, bandwidth=150e6, azimuth_resolution=1.0, polarisation=",".join(QUAD), aim_z=0.0
    )
    film = FilmDescription(
        image_extent_azimuth=24.0, image_extent_range=24.0, image_center_x=0.0, image_center_y=0.0
    )
    radar = replace(radar, aim_x=0.0, aim_y=0.0)
    data = 0.0
    for target in CORNERS:
        point = PointTarget("corner", np.asarray(target.position), 100.0)
        raw = simulate(build_scene([], [point], radar=radar, film=film), seed=1)
        # as many echoes as channels, by the target's matrix, received polarisation first
        weights = np.array([target.matrix["HV".index(c[1]), "HV".index(c[0])] for c in QUAD], np.complex64)
        data = data + weights[:, None, None] * raw.data[0]
    chain = ReceiveChain(transmit_distortion=_text(transmitter), receive_distortion=_text(receiver))
    raw = replace(raw, data=data, layers=tuple(map(Layer, QUAD)), radar=replace(raw.radar, chain=chain))
    image = focus(receive(raw), range_window="taylor", azimuth_window="taylor")
    found = calibrate_polarimetry(image, CORNERS)
    # tol: side lobes of the other corners, -35 dB and less of their matrices at 10 cells
    assert np.abs(found.receive - receiver).max() < 0.01
    assert np.abs(found.transmit - transmitter).max() < 0.01
    clean = found.correct(image)
    rows = [f"{t.kind},{','.join(map(str, t.position))},{np.degrees(t.rotation)}" for t in CORNERS]
    table = tmp_path / "corners.csv"
    table.write_text("kind,x_m,y_m,z_m,rotation_deg\n" + "\n".join(rows) + "\n", encoding="utf-8")
    image.save(tmp_path / "image.h5")
    assert cli.main(["polarimetry", str(tmp_path / "image.h5"), "--targets", str(table)]) == 0
    receive_row = json.loads((tmp_path / "polarimetry.json").read_text())["calibration"]["receive"]
    assert np.allclose([complex(*z) for z in receive_row], found.receive.ravel())
    peak = np.unravel_index(np.argmax(np.abs(clean.total("VV"))), clean.grid.shape)
    values = {channel: clean.total(channel)[peak] for channel in QUAD}
    assert abs(values["HV"]) < 0.01 * abs(values["VV"]) and abs(abs(values["HH"] / values["VV"]) - 1.0) < 0.02


def test_too_few_targets_and_channels_are_one_line():
    two = CORNERS[:2]
    ideal = np.array([target.matrix for target in two])
    with pytest.raises(DataError, match="2 targets leave parameters of the radar open"):
        solve_distortion(ideal + 0j, ideal)
    with pytest.raises(DataError, match="a target has no echo"):
        solve_distortion(0j * ideal, ideal)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("kind,x_m,y_m\ntrihedral,1,2\n", "no column z_m"),
        ("kind,x_m,y_m,z_m,turn\n", 'column "turn"'),
        ("kind,x_m,y_m,z_m\nsphere,1,2,3\n", 'kind "sphere" is neither'),
        ("kind,x_m,y_m,z_m\ntrihedral,1,2\n", ":2: "),
        ("kind,x_m,y_m,z_m\ntrihedral,1,2,inf\n", "not finite"),
        ("kind,x_m,y_m,z_m\n", "no rows"),
    ],
)
def test_bad_tables_are_one_line(tmp_path, text, words):
    (tmp_path / "t.csv").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=words):
        read_targets(tmp_path / "t.csv")
