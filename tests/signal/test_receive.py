"""The receive chain on echoes of points and clutter, against closed forms and brute force on drawn radars."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT, SUBSET_SHARES
from sarmitsuba.core.units import db_from_power
from sarmitsuba.files import read_raw, write_raw
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.receive_chain import ReceiveChain
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.signal import receive as receiving
from sarmitsuba.signal.chirp import n_fast_chirped
from sarmitsuba.signal.quantiser import lloyd_max_quantiser
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.signal.receive import (
    distort,
    echo_delay,
    find_transmissions,
    oscillator_phase,
    pulse_factors,
    receive,
    record_samples,
)

QUAD = ("HH", "HV", "VH", "VV")
ONE = (Layer("VV"),)


def _radar(chain, n_pulses=64, n_samples=500, prf=300.0, pulse_width=2e-6, **others):
    time = np.arange(n_pulses) / prf
    position = np.array([-7e3, 0.0, 7e3]) + np.outer(time - time.mean(), [0.0, 100.0, 0.0])
    track = Track(time, position, np.tile([0.0, 100.0, 0.0], (n_pulses, 1)))
    axes = np.tile(np.eye(3)[:, None], (1, n_pulses, 1))
    spacing = SPEED_OF_LIGHT / (2.0 * 1.2 * 150e6)
    start = np.full(n_pulses, 9.9e3 - 0.5 * n_samples * spacing)
    window = ReceiveWindow(start, spacing, n_samples)
    wave = Waveform(9.65e9, 150e6, pulse_width)
    return Radar("spotlight", track, wave, Antenna(), Pointing(*axes), window, chain=chain, **others)


def _point(radar, layers=ONE, seed=0):
    """Echo of one point in the middle of the window, of random phase in every layer."""
    window = radar.window
    r = window.start_range[:, None] + window.sample_spacing * np.arange(window.n_samples)
    profile = np.sinc((r - 9.9e3) / radar.waveform.range_cell)
    turns = np.exp(2j * np.pi * np.random.default_rng(seed).random(len(layers)))
    return RawData((turns[:, None, None] * profile).astype(np.complex64), layers, "compressed", radar)


def _clutter(radar, layers=ONE, seed=0):
    rng = np.random.default_rng(seed)
    n, m = radar.track.n_pulses, radar.window.n_samples
    pair = rng.standard_normal((len(layers), n, m, 2), dtype=np.float32)
    band = np.abs(np.fft.fftfreq(m)) < 0.4
    data = np.fft.ifft(np.fft.fft(pair.view(np.complex64)[..., 0]) * band).astype(np.complex64)
    return RawData(data, layers, "compressed", radar)


def test_ideal_chain_changes_no_bit():
    raw = _clutter(_radar(None))
    assert receive(raw) is raw
    # the receiver is never off: the next pulse is sent long after the echoes
    gaps = _clutter(_radar(ReceiveChain(transmit_gaps=True)))
    assert np.array_equal(receive(gaps).data, raw.data)


def test_planes_add_up_to_what_is_received():
    chain = ReceiveChain(
        adc_bits=3, iq_gain_db=1.0, phase_noise="10:-60,100:-70", dead_pulses=0.1, gain_jitter_db=0.5
    )
    radar = _radar(chain, noise_temperature=500.0)
    layers = tuple(Layer("VV", order, subset) for order in (1, 2) for subset in (1, 2))
    parts = _clutter(radar, layers)
    whole = replace(parts, data=parts.data.sum(axis=0, keepdims=True), layers=(Layer("VV"),))
    received, alone = receive(parts, seed=3), receive(whole, seed=3)
    # tol: float32 sums in another order, and quantiser cells that they cross
    change = np.linalg.norm(received.data.sum(axis=0) - alone.data[0]) / np.linalg.norm(alone.data)
    assert change < 2e-3
    assert sum(SUBSET_SHARES[layer.subset] for layer in layers[:2]) == 1.0


def test_same_seed_same_bits_and_other_seed_others():
    chain = ReceiveChain(phase_noise="1:-50,1000:-80", dead_pulses=0.2, raw_coding="baq", baq_bits=2)
    raw = _clutter(_radar(chain, noise_temperature=300.0))
    first = receive(raw, seed=5).data
    assert np.array_equal(first, receive(raw, seed=5).data)
    assert not np.array_equal(first, receive(raw, seed=6).data)


def test_batches_of_pulses_are_those_of_the_whole(monkeypatch):
    chain = ReceiveChain(adc_bits=4, transmit_gaps=True, iq_phase_deg=4.0)
    raw = _clutter(_radar(chain, n_pulses=23, prf=7000.0))
    whole = receive(raw).data
    monkeypatch.setattr(receiving, "_BATCH", 5 * n_fast_chirped(raw.radar))
    # tol: the rms of the record is summed in another order, in float32
    assert np.linalg.norm(receive(raw).data - whole) < 1e-3 * np.linalg.norm(whole)


@pytest.mark.parametrize("bits", [2, 4])
def test_noise_after_baq_has_gain_and_white_quantisation_noise(bits):
    radar = _radar(
        ReceiveChain(raw_coding="baq", baq_bits=bits),
        n_pulses=200,
        n_samples=2000,
        pulse_width=4e-6,
        noise_temperature=500.0,
    )
    silent = RawData(np.zeros((1, 200, 2000), np.complex64), (Layer("VV"),), "compressed", radar)
    clean = receive(replace(silent, radar=replace(radar, chain=None)), seed=1).data
    coded = receive(silent, seed=1).data
    gain = lloyd_max_quantiser(bits).gain
    found = np.vdot(clean, coded) / np.vdot(clean, clean)
    assert abs(found - gain) < 0.01  # tol: 400000 samples, and blocks with the ends of the record
    # noise of power alpha (1 - alpha), white over the sampling rate, of which the band holds 1 / 1.2
    expected = gain * (1.0 - gain) / 1.2
    rest = np.sum(np.abs(coded - found * clean) ** 2) / np.sum(np.abs(clean) ** 2)
    # tol: the inverse filter raises white noise by about 1 / sqrt(B T), 4 %; weaker ends of the record
    assert rest == pytest.approx(expected, rel=0.12)


@pytest.mark.parametrize("seed", range(4))
def test_demodulator_leaves_an_image_of_the_stated_rejection(seed):
    rng = np.random.default_rng(seed)
    chain = ReceiveChain(iq_gain_db=float(rng.uniform(-2, 2)), iq_phase_deg=float(rng.uniform(-15, 15)))
    radar = _radar(chain, n_pulses=8, n_samples=1000)
    echoes = _clutter(radar).data[0]
    out, _ = record_samples(echoes, radar, slice(None), 1.0)
    g, phase = 10.0 ** (chain.iq_gain_db / 20.0), np.radians(chain.iq_phase_deg)
    brute = echoes.real + 1j * g * (echoes * np.exp(-1j * phase)).imag
    assert np.allclose(out, brute, atol=1e-5 * np.abs(echoes).max())  # tol: float32
    k1, k2 = chain.quadrature
    # the mirrored chirp of a point is spread over twice its length: its energy is |K2 / K1|^2 of the point's
    raw = _point(radar)
    data = receive(raw).data[0]
    found = np.vdot(raw.data[0], data) / np.vdot(raw.data[0], raw.data[0])
    rest = np.sum(np.abs(data - found * raw.data[0]) ** 2) / np.sum(np.abs(found * raw.data[0]) ** 2)
    # tol: 3 % of the mirrored chirp is outside the window or correlated with the point
    assert abs(found - k1) < 0.03 * abs(k1)
    assert db_from_power(rest) == pytest.approx(db_from_power(abs(k2 / k1) ** 2), abs=0.2)


def test_offset_is_a_tone_at_the_centre_of_the_band():
    radar = _radar(ReceiveChain(iq_offset_i=0.5, iq_offset_q=-0.25))
    echoes = np.zeros((64, n_fast_chirped(radar)), np.complex64)
    out, _ = record_samples(echoes, radar, slice(None), 2.0)
    assert np.array_equal(out, np.full_like(out, 1.0 - 0.5j))


@pytest.mark.parametrize("bistatic", [False, True])
def test_oscillator_phase_has_its_spectrum(bistatic):
    chain = ReceiveChain(phase_noise="3:-35,30:-50,400:-70,5000:-80")
    radar = _radar(chain, n_pulses=256)
    if bistatic:
        moved = replace(radar.track, position=radar.track.position + np.array([0.0, 0.0, 50.0]))
        radar = replace(radar, receiver=moved)
        assert echo_delay(radar) is None
    else:  # a delay at which the filter matters
        radar = replace(radar, aim_point=np.array([1e5, 0.0, 0.0]))
    n, prf = 256, 300.0
    draws = np.array([oscillator_phase(radar, np.random.default_rng(i)) for i in range(400)])
    delay, width = echo_delay(radar), radar.waveform.pulse_width
    # brute force: the variance of the aliased spectrum by a fine sum, above the lowest frequency that is drawn
    step = 0.5 * prf / n
    f = np.arange(0.5 * step, 5000.0, 0.02)
    variance = np.sum(chain.phase_density(f, delay, width)) * 0.02
    # tol: 400 draws of 256 correlated numbers, and the coarse steps of the drawn lines below 3 Hz
    assert np.mean(draws**2) == pytest.approx(variance, rel=0.08)
    assert chain.phase_variance(0.5 * step, delay, width) == pytest.approx(variance, rel=0.02)


def test_phase_noise_moves_energy_from_the_peak_to_the_side_lobes():
    # white above the inverse of the aperture: the peak falls by exp(-sigma^2), side lobes have exp(sigma^2) - 1 of it
    chain = ReceiveChain(phase_noise="1:-42,2000:-42")
    radar = replace(_radar(chain, n_pulses=256), aim_point=np.array([1e5, 0.0, 0.0]))
    peaks, lobes, variances = [], [], []
    for seed in range(60):
        factors, facts = pulse_factors(radar, seed)
        variances.append(facts["phase_noise_rms_rad"] ** 2)
        peak = abs(factors.mean()) ** 2
        peaks.append(peak)
        lobes.append((1.0 - peak) / peak)
    variance = np.mean(variances)
    assert 0.1 < variance < 1.0
    # tol: 60 draws of 256 pulses
    assert np.mean(peaks) == pytest.approx(np.exp(-variance), rel=0.03)
    assert np.mean(lobes) == pytest.approx(np.expm1(variance), rel=0.08)


def test_dead_pulses_and_drift_are_those_asked_for():
    radar = _radar(ReceiveChain(dead_pulses=0.25, gain_drift_db=3.0), n_pulses=400)
    factors, facts = pulse_factors(radar, 7)
    lost = factors == 0.0
    assert lost.sum() == 100 == facts["dead_pulses"]
    share = np.linspace(-0.5, 0.5, 400)
    assert np.allclose(np.abs(factors[~lost]), 10.0 ** (3.0 * share[~lost] / 20.0))
    received = receive(_clutter(radar), seed=7).data[0]
    assert not received[lost].any() and received[~lost].any(axis=1).all()
    # energy in side lobes over that of the peak: p / (1 - p)
    kept = (~lost).astype(float)
    peak = kept.mean() ** 2
    assert (np.mean(kept**2) - peak) / peak == pytest.approx(0.25 / 0.75)


@pytest.mark.parametrize("seed", range(3))
def test_gaps_are_where_a_pulse_is_sent(seed):
    rng = np.random.default_rng(seed)
    chain = ReceiveChain(transmit_gaps=True)
    radar = _radar(chain, n_pulses=30, n_samples=800)
    # staggered intervals about the delay of the echoes, 66 us
    time = np.cumsum(rng.uniform(8e-6, 20e-6, 30))
    track = replace(radar.track, time=time)
    radar = replace(radar, track=track)
    blind = find_transmissions(radar, slice(3, 9))
    last = time[-1] - time[-2]
    sent = np.concatenate([[2 * time[0] - time[1]], time, time[-1] + last * np.arange(1, 40)])
    width, rate = radar.waveform.pulse_width, radar.window.sampling_rate
    for row, pulse in enumerate(range(3, 9)):
        for i in range(0, blind.shape[1], 7):
            at = time[pulse] + 2 * radar.window.start_range[pulse] / SPEED_OF_LIGHT - 0.5 * width + i / rate
            assert blind[row, i] == (np.abs(at - sent).min() <= 0.5 * width)
    assert 0.05 < blind.mean() < 0.6


@pytest.mark.parametrize("seed", range(4))
def test_distortion_is_the_product_of_the_matrices(seed):
    rng = np.random.default_rng(seed)

    def draw():
        m = np.eye(2) + 0.2 * (rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2)))
        return m, ",".join(f"{v.real:.17g}{v.imag:+.17g}j" for v in m.ravel())

    (t, transmit), (r, received) = draw(), draw()
    chain = ReceiveChain(transmit_distortion=transmit, receive_distortion=received)
    layers = tuple(Layer(c, order) for order in (1, 2) for c in QUAD)
    raw = _clutter(_radar(chain, n_pulses=4, n_samples=16), layers, seed)
    out = distort(raw, chain)
    for first in (0, 4):
        hh, hv, vh, vv = raw.data[first : first + 4]
        s = np.array([[hh, vh], [hv, vv]])  # received polarisation first
        m = np.einsum("ij,jk...,kl->il...", r, s, t)
        for row, (i, k) in enumerate([(0, 0), (1, 0), (0, 1), (1, 1)]):
            # tol: float32
            assert np.allclose(out.data[first + row], m[i, k], atol=1e-5)
    compact = replace(raw, layers=(Layer("RH"), Layer("RV")), data=raw.data[:2])
    mixed = distort(compact, ReceiveChain(receive_distortion=received))
    assert np.allclose(mixed.data, np.einsum("ij,j...->i...", r, compact.data), atol=1e-5)


def test_noise_figure_of_saturation_in_compressed_data():
    # clutter of many points clipped at its rms: the coherent gain is Bussgang's
    radar = _radar(ReceiveChain(saturation_db=0.0), n_pulses=40, n_samples=3000)
    raw = _clutter(radar)
    out = receive(raw).data
    found = np.vdot(raw.data, out) / np.vdot(raw.data, raw.data)
    # tol: the ends of the record are weaker, so that the middle is 3 % above the record's rms
    assert abs(found - 0.6827) < 0.04


def test_chain_is_kept_in_files(tmp_path):
    chain = ReceiveChain(
        adc_bits=6,
        saturation_db=9.0,
        raw_coding="fdbaq",
        fdbaq_margin_db=2.0,
        phase_noise="10:-70,100:-90",
        transmit_gaps=True,
        receive_distortion="1,0.02+0.01j,0,1.1",
    )
    raw = receive(_clutter(_radar(chain, noise_temperature=300.0, channels=QUAD), tuple(map(Layer, QUAD))))
    write_raw(raw, tmp_path / "raw.h5")
    again = read_raw(tmp_path / "raw.h5")
    assert again.radar.chain == chain
    assert np.array_equal(again.data, raw.data)
    assert set(again.metadata["receive_chain"]["fdbaq_mean_bits"]) == set(QUAD)
