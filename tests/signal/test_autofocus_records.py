"""Autofocus records of Gotcha-like files undo the errors that a test put into the data, and our autofocus agrees."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.ndimage

from sarmitsuba import cli
from sarmitsuba.core.errors import DataError
from sarmitsuba.files import read_image, read_raw, write_image, write_raw
from sarmitsuba.signal.focusing import apply_autofocus_records, default_grid
from sarmitsuba.signal.focusing.autofocus import AutofocusTask, parse_autofocus
from sarmitsuba.signal.focusing.focuser import parse_focuser
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import calibrate
from sarmitsuba.view.display import PictureOptions, prepare
from tests.support.draws import few_of
from tests.support.unweighted import focus

LIGHT = 299792458.0
N_PULSES = 240


def errors(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A smooth range error (rms 2 cm) and a smooth phase (rms 1 rad) of every pulse."""
    smooth = scipy.ndimage.gaussian_filter1d(rng.normal(size=(2, N_PULSES)), 14.0, axis=1, mode="wrap")
    smooth *= np.array([0.02, 1.0])[:, None] / smooth.std(axis=1, keepdims=True)
    return smooth[0], smooth[1]


def save(path: Path, seed: int, *, spoilt: bool, recorded: bool, channel: str = "VV") -> np.ndarray:
    """Write a file in the layout of the Gotcha set: a flight along part of a circle, some points, a little noise.

    The true range of an echo is that of the positions plus the error; returns that error at the carrier, m.
    """
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.0, 2.0 * np.pi) + np.radians(3.0) * np.arange(N_PULSES) / N_PULSES
    radius, height = rng.uniform(6e3, 8e3), rng.uniform(5e3, 7e3)
    place = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(N_PULSES, height)], axis=1)
    f = 9.6e9 + 1.5e6 * (np.arange(280) - 139.5)
    r0 = np.linalg.norm(place, axis=1)
    points = np.column_stack([rng.uniform(-22.0, 22.0, (12, 2)), np.zeros(12)])
    amplitude = rng.uniform(0.7, 1.5, 12) * np.exp(1j * rng.uniform(-3.0, 3.0, 12))
    late, phase = errors(np.random.default_rng([seed, len(channel), ord(channel[0])]))
    fp = np.zeros((f.size, N_PULSES), complex)
    for point, value in zip(points, amplitude, strict=True):
        away = np.linalg.norm(place - point, axis=1) - r0
        fp += value * np.exp(-4j * np.pi * f[:, None] * away / LIGHT)
    fp += 0.05 * (rng.normal(size=fp.shape) + 1j * rng.normal(size=fp.shape))
    if spoilt:  # noise too, so that the corrected data are the clean ones
        fp *= np.exp(-4j * np.pi * f[:, None] * late / LIGHT + 1j * phase)
    data = {
        "fp": fp.astype(np.complex64),
        "freq": f[:, None],
        **{name: place[None, :, i] for i, name in enumerate("xyz")},
        "r0": r0[None],
    }
    if recorded:
        # fp exp(j ph_correct) is summed with exp(j 4 pi f (R - r0 - r_correct) / c), R by the positions: in phase where
        # R - r0 - r_correct is the delay in fp, R + late - r0
        data["af"] = {"r_correct": -late[None], "ph_correct": -phase[None]}
    scipy.io.savemat(path, {"data": data})
    middle = 0.5 * (f[0] + f[-1])
    return late - LIGHT / (4.0 * np.pi * middle) * phase


@pytest.mark.parametrize("seed", few_of(range(6), 2))
def test_records_undo_the_errors_and_our_autofocus_finds_the_same(tmp_path: Path, seed: int) -> None:
    save(tmp_path / "clean.mat", seed, spoilt=False, recorded=False)
    put_in = save(tmp_path / "spoilt.mat", seed, spoilt=True, recorded=True)
    request = {"extent_azimuth": 60.0, "extent_range": 60.0}
    raw = read_raw(tmp_path / "spoilt.mat")
    wavelength = raw.radar.waveform.wavelength
    records = raw.autofocus_records["VV"]
    np.testing.assert_allclose(records.range_error(wavelength), put_in, atol=1e-6)

    clean, spoilt, mended = (
        focus(one, request=request)
        for one in (read_raw(tmp_path / "clean.mat"), raw, apply_autofocus_records(raw))
    )
    peak = [float(np.abs(image.data).max()) for image in (clean, spoilt, mended)]
    assert 20.0 * np.log10(peak[1] / peak[0]) < -2.0
    assert mended.metadata["autofocus_records"] == "applied"
    # tol: profiles are shifted by up to 6 cm of a range cell of 0.36 m at the swath's ends
    assert np.linalg.norm(mended.data - clean.data) < 0.01 * np.linalg.norm(clean.data)

    # our autofocus against the records as the truth, up to a constant and a slope
    task = AutofocusTask(
        raw, default_grid(raw, request), parse_focuser("backprojection"), *[parse_window("rectangular")] * 2
    )
    method = parse_autofocus("phase_gradient")
    assert method is not None
    found = method.estimate(task)
    left = found - records.range_error(wavelength)
    left -= np.polyval(np.polyfit(np.arange(N_PULSES), left, 1), np.arange(N_PULSES))
    print(f"left of {1e3 * np.std(put_in):.1f} mm rms: {1e3 * np.sqrt(np.mean(left**2)):.2f} mm")
    # tol: 0.1 to 0.8 mm are left, 0.05 to 0.3 rad two-way, mostly at the ends: side lobes of 12 points in each other.
    # 1 mm costs a peak 0.7 dB
    assert float(np.sqrt(np.mean(left**2))) < 1e-3
    assert float(np.sqrt(np.mean(put_in**2))) > 10e-3


def test_every_channel_has_its_own_records_through_hdf5(tmp_path: Path) -> None:
    folder = tmp_path / "pass"
    folder.mkdir()
    for channel in ("HH", "VV"):
        save(folder / f"a_{channel}.mat", 3, spoilt=True, recorded=True, channel=channel)
        save(tmp_path / f"clean_{channel}.mat", 3, spoilt=False, recorded=False, channel=channel)
    raw = read_raw(folder)
    write_raw(raw, tmp_path / "raw.h5")
    again = read_raw(tmp_path / "raw.h5")
    for channel in ("HH", "VV"):
        one, other = raw.autofocus_records[channel], again.autofocus_records[channel]
        np.testing.assert_array_equal(one.range_correction, other.range_correction)
        np.testing.assert_array_equal(one.phase_correction, other.phase_correction)
        got = apply_autofocus_records(again).total(channel)
        clean = read_raw(tmp_path / f"clean_{channel}.mat").total()
        assert np.linalg.norm(got - clean) < 0.02 * np.linalg.norm(
            clean
        )  # tol: the shift at the swath's ends
    some = again.of_pulses(slice(10, 60))
    np.testing.assert_array_equal(
        some.autofocus_records["HH"].range_correction,
        raw.autofocus_records["HH"].range_correction[10:60],
    )


def test_the_command_applies_them_when_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(tmp_path / "a.mat", 1, spoilt=True, recorded=True)
    save(tmp_path / "bare.mat", 1, spoilt=True, recorded=False)
    small = ["--extent", "20", "--no-chart", "--format", "hdf5"]
    assert cli.main(["focus", str(tmp_path / "a.mat"), "-o", str(tmp_path / "out"), *small]) == 0
    assert "--autofocus-records applies them" in capsys.readouterr().out
    done = ["focus", str(tmp_path / "a.mat"), "-o", str(tmp_path / "mended"), "--autofocus-records", *small]
    assert cli.main(done) == 0
    assert "not applied" not in capsys.readouterr().out
    with h5py.File(tmp_path / "out/image.h5") as plain, h5py.File(tmp_path / "mended/image.h5") as mended:
        assert np.abs(mended["image/VV"][:]).max() > 1.05 * np.abs(plain["image/VV"][:]).max()
    bare = ["focus", str(tmp_path / "bare.mat"), "-o", str(tmp_path / "bare"), "--autofocus-records", *small]
    assert cli.main(bare) == 2
    message = capsys.readouterr().err
    assert "channel VV has none" in message and message.count("\n") == 1


@pytest.mark.parametrize(
    ("af", "text"),
    [
        (np.ones(3), "af is not a struct"),
        ({"r_correct": np.zeros(N_PULSES)}, "af is not a struct"),
        ({"r_correct": np.zeros(N_PULSES), "ph_correct": np.zeros(5)}, "af.ph_correct has 5 finite values"),
        (
            {"r_correct": np.full(N_PULSES, np.nan), "ph_correct": np.zeros(N_PULSES)},
            "af.r_correct has 0 finite",
        ),
        ({"r_correct": np.zeros(N_PULSES) + 1j, "ph_correct": np.zeros(N_PULSES)}, "af.r_correct is complex"),
        ({"r_correct": "none", "ph_correct": np.zeros(N_PULSES)}, "af.r_correct holds"),
    ],
)
def test_wrong_records_are_one_line(tmp_path: Path, af: object, text: str) -> None:
    save(tmp_path / "a.mat", 1, spoilt=True, recorded=True)
    content = scipy.io.loadmat(tmp_path / "a.mat")["data"][0, 0]
    data = {name: content[name] for name in content.dtype.names} | {"af": af}
    scipy.io.savemat(tmp_path / "b.mat", {"data": data})
    with pytest.raises(DataError) as caught:
        read_raw(tmp_path / "b.mat")
    assert text in str(caught.value) and "\n" not in str(caught.value) and "b.mat" in str(caught.value)


def test_pictures_of_uncalibrated_data_do_not_say_sigma0(tmp_path: Path) -> None:
    save(tmp_path / "a.mat", 1, spoilt=False, recorded=False)
    image = focus(read_raw(tmp_path / "a.mat"), request={"extent_azimuth": 20.0, "extent_range": 20.0})
    assert not image.calibrated
    for quantity in ("sigma0", "gamma0", "beta0", "rcs"):
        shown = prepare(image, PictureOptions(quantity=quantity), 400)
        assert shown.label == "intensity, uncalibrated (dB)"
        np.testing.assert_allclose(shown.values.max(), 20.0 * np.log10(np.abs(image.data).max()), atol=1e-3)
    assert prepare(image, PictureOptions(quantity="amplitude"), 400).label == "amplitude, uncalibrated"
    for suffix in (".nitf", ".h5"):
        write_image(image, tmp_path / f"image{suffix}")
        assert not read_image(tmp_path / f"image{suffix}").calibrated
    write_raw(read_raw(tmp_path / "a.mat"), tmp_path / "raw.cphd")
    assert not read_raw(tmp_path / "raw.cphd").calibrated
    absolute = calibrate(image, float(image.rcs().max()), 10.0)
    assert absolute.calibrated and prepare(absolute, PictureOptions(), 400).label == "sigma0 (dB)"
