"""LFM echoes, receiver noise and the radar equation."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.fft

from sarmitsuba.core.constants import BOLTZMANN, SPEED_OF_LIGHT, SUBSET_SHARES
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.link_budget import nesz, received_power, snr
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.signal.chirp import chirp_spectrum, n_fast_chirped, pulse_samples, to_chirped
from sarmitsuba.signal.noise import add_noise, noise_power
from sarmitsuba.signal.raw_data import Layer, RawData


def _radar(n_pulses=2, n_samples=400, bandwidth=150e6, pulse_width=4e-6, oversampling=1.2, **others):
    track = Track.straight([-7e3, 0.0, 7e3], [0.0, 100.0, 0.0], 200.0, n_pulses)
    spacing = SPEED_OF_LIGHT / (2.0 * bandwidth * oversampling)
    zero = np.zeros((n_pulses, 3))
    return Radar(
        "spotlight",
        track,
        Waveform(9.65e9, bandwidth, pulse_width),
        Antenna(),
        Pointing(zero, zero, zero),
        ReceiveWindow(9.9e3 + 3.3 * np.arange(n_pulses), spacing, n_samples),
        **others,
    )


def _points(radar, ranges, amplitudes):
    """Compressed data of points at the same range in every pulse."""
    w = radar.window
    r = w.start_range[:, None] + w.sample_spacing * np.arange(w.n_samples)
    data = sum(
        a * np.sinc((r - p) / radar.waveform.range_cell) for p, a in zip(ranges, amplitudes, strict=True)
    )
    return RawData(data[None].astype(np.complex64), (Layer("VV"),), "compressed", radar)


def _compress(chirped, radar, matched):
    n_fft = scipy.fft.next_fast_len(chirped.shape[-1])
    spectrum = chirp_spectrum(radar, n_fft)
    bandwidth, rate = radar.waveform.bandwidth, radar.window.sampling_rate
    band = np.abs(scipy.fft.fftfreq(n_fft, 1.0 / rate)) <= 0.5 * bandwidth
    gain = np.zeros(n_fft, dtype=np.complex128)
    if matched:
        gain[band] = spectrum.conj()[band] / len(pulse_samples(radar.waveform, rate))
    else:
        gain[band] = rate / bandwidth / spectrum[band]
    return scipy.fft.ifft(scipy.fft.fft(chirped, n=n_fft) * gain)[..., : radar.window.n_samples]


def test_echo_is_the_pulse_at_the_stated_fast_times():
    radar = _radar(n_samples=800)
    point, peak = 9.9e3 + 330.37, 2.0 - 1.0j
    chirped = to_chirped(_points(radar, [point], [peak]))
    assert chirped.domain == "chirped"
    assert chirped.data.shape[-1] == n_fast_chirped(radar)
    rate, width = radar.window.sampling_rate, radar.waveform.pulse_width
    for t in range(2):
        fast = 2.0 * radar.window.start_range[t] / SPEED_OF_LIGHT - 0.5 * width
        time = fast + np.arange(n_fast_chirped(radar)) / rate - 2.0 * point / SPEED_OF_LIGHT
        ideal = (
            peak * np.exp(1j * np.pi * radar.waveform.chirp_rate * time**2) * (np.abs(time) <= 0.5 * width)
        )
        inner = np.abs(time) < 0.35 * width
        outside = np.abs(time) > 0.75 * width
        # tol: 3 % of the peak: Fresnel ripple; the receiver's filter cuts the pulse's spectrum at the band's edge
        assert np.abs(chirped.data[0, t] - ideal)[inner].max() < 0.03 * abs(peak)
        assert outside.sum() > 100
        assert np.abs(chirped.data[0, t])[outside].max() < 0.03 * abs(peak)
        assert np.abs(ideal).sum() > 0.0


@pytest.mark.parametrize("oversampling", [1.0, 1.2, 2.0])
def test_compressing_again_loses_nothing(oversampling):
    radar = _radar(oversampling=oversampling)
    middle = 9.9e3 + 0.5 * radar.window.extent
    raw = _points(radar, [middle - 20.3, middle, middle + 31.7], [1.0, 3.0j, -2.0])
    back = _compress(to_chirped(raw).data, radar, matched=False)
    error = np.sum(np.abs(back - raw.data) ** 2) / np.sum(np.abs(raw.data) ** 2)
    # tol: -35 dB, tails of the sinc that the window cuts are not band limited; the filter itself is exact
    assert 10.0 * np.log10(error) < -35.0


def test_matched_filter_gives_the_peak():
    radar = _radar(n_samples=2000, pulse_width=10e-6)
    window = radar.window
    point = window.start_range[0] + 1000 * window.sample_spacing
    profile = _compress(to_chirped(_points(radar, [point], [1.0])).data, radar, matched=True)[0, 0]
    assert int(np.argmax(np.abs(profile))) == 1000
    # tol: 3 % energy outside the band at a time-bandwidth product of 1500
    assert abs(profile[1000] - 1.0) < 0.03


def test_chirped_data_are_not_chirped_twice():
    radar = _radar()
    chirped = to_chirped(_points(radar, [1e4], [1.0]))
    with pytest.raises(DataError, match="chirped"):
        to_chirped(chirped)


_ONE_LAYER = (Layer("VV"),)


def _silent(radar, domain, layers=_ONE_LAYER):
    n = radar.window.n_samples if domain == "compressed" else n_fast_chirped(radar)
    data = np.zeros((len(layers), radar.track.n_pulses, n), dtype=np.complex64)
    return RawData(data, layers, domain, radar)


def test_noise_power_and_colour():
    radar = _radar(n_pulses=300, noise_temperature=600.0)
    chirped = add_noise(_silent(radar, "chirped"), seed=1).data[0]
    compressed = add_noise(_silent(radar, "compressed"), seed=1).data[0]
    assert noise_power(radar, "chirped") == BOLTZMANN * 600.0 * radar.window.sampling_rate
    for domain, noise, share in (("chirped", chirped, 1.0), ("compressed", compressed, 1.0 / 1.2)):
        power = float(np.mean(np.abs(noise.astype(np.complex128)) ** 2))
        # tol: 5 sigma of the mean of n independent exponentials
        tolerance = 5.0 / np.sqrt(noise.size * share)
        assert abs(power / noise_power(radar, domain) - 1.0) < tolerance
        # circular: the mean of the square vanishes
        assert abs(np.mean(noise.astype(np.complex128) ** 2)) / power < tolerance
    window = np.hanning(compressed.shape[1])
    spectrum = np.mean(np.abs(scipy.fft.fft(compressed * window)) ** 2, axis=0)
    frequency = np.abs(scipy.fft.fftfreq(compressed.shape[1])) * 1.2
    inside, outside = spectrum[frequency < 0.48].mean(), spectrum[frequency > 0.53].mean()
    # tol: 1e-4, leakage of the Hann window into the empty guard band
    assert outside < 1e-4 * inside


def test_both_routes_agree():
    """Noise added to chirped echoes and compressed has the power of noise added to the profiles."""
    radar = _radar(n_pulses=300, pulse_width=10e-6, noise_temperature=290.0)
    through = add_noise(_silent(radar, "chirped"), seed=2).data[0].astype(np.complex128)
    direct = add_noise(_silent(radar, "compressed"), seed=3).data[0].astype(np.complex128)
    expected = np.mean(np.abs(direct) ** 2)
    samples = direct.size / 1.2
    statistics = 5.0 * np.sqrt(2.0 / samples)  # 5 sigma of the ratio of two means
    for matched in (False, True):
        # exact white-noise gain of this filter, from the spectrum of the sampled pulse
        n_fft = scipy.fft.next_fast_len(through.shape[1])
        impulse = np.zeros((1, n_fft))
        impulse[0, 0] = 1.0
        wide = replace(radar, window=replace(radar.window, n_samples=n_fft))
        gain = np.sum(np.abs(_compress(impulse, wide, matched)) ** 2)
        power = np.mean(np.abs(_compress(through, radar, matched)) ** 2)
        # tol: 5 sigma
        assert abs(power / (gain * noise_power(radar, "chirped")) - 1.0) < statistics
        # tol: 5 sigma and 8 %: the ripple of the LFM spectrum, whose edges lie 6 dB down, raises the inverse
        # filter's noise and lowers the matched one's
        assert abs(power / expected - 1.0) < 0.08 + statistics


def test_noise_is_seeded_and_belongs_to_the_channel():
    radar = _radar(noise_temperature=290.0, channels=("HH", "VV"))
    layers = tuple(Layer(c, o, h) for h in (1, 2) for o in (1, 2) for c in ("HH", "VV"))
    raw = _silent(radar, "compressed", layers)
    first, again, other = (add_noise(raw, seed=s) for s in (7, 7, 8))
    assert np.array_equal(first.data, again.data)
    assert not np.array_equal(first.data, other.data)
    assert not np.array_equal(first.total("HH"), first.total("VV"))
    second_order = [i for i, layer in enumerate(layers) if layer.order == 2]
    assert not first.data[second_order].any()
    subsets = [i for i, layer in enumerate(layers) if layer.order == 1 and layer.channel == "HH"]
    own = [first.data[i] / SUBSET_SHARES[layers[i].subset] for i in subsets]
    np.testing.assert_allclose(own[0], own[1], rtol=1e-6)  # the subsets' difference stays clean
    one_layer = add_noise(_silent(radar, "compressed", (Layer("HH"),)), seed=7)
    # tol: rounding of the sum of two subsets
    np.testing.assert_allclose(first.total("HH"), one_layer.total("HH"), rtol=1e-5)
    assert first.metadata["noise_temperature_K"] == 290.0
    assert not raw.data.any()  # the input is left alone


def test_no_temperature_no_noise():
    raw = _silent(_radar(), "compressed")
    assert add_noise(raw) is raw
    with pytest.raises(RadarError, match="noise_temperature"):
        snr(_radar(), 1.0, 1e4)


def _equation(frequency, power, width, gain_db, temperature, loss_db=0.0):
    radar = _radar(transmit_power=power, noise_temperature=temperature, losses=10.0 ** (loss_db / 10))
    return replace(
        radar, waveform=Waveform(frequency, 1e6, width), antenna=Antenna(gain=10.0 ** (gain_db / 10))
    )


def test_radar_equation_against_published_examples():
    """MathWorks' examples of radareqsnr (two monostatic ones) and radareqsarsnr; inputs as published there."""
    first = snr(_equation(1e9, 1e6, 0.2e-6, 20.0, 290.0), 1.0, 50e3)
    second = snr(_equation(10e9, 1e6, 1e-6, 40.0, 300.0, 3.0), 0.5, 100e3)
    image = snr(_equation(5.3e9, 5e3, 0.05e-6, 20.0, 290.0), 1.0, 50e3) * 10.0 ** ((29.8 + 42.7) / 10.0)
    # tol: 5e-5 dB, the four decimals published
    assert abs(10.0 * np.log10(first) - 5.5868) < 6e-5
    assert abs(10.0 * np.log10(second) - 14.3778) < 6e-5
    assert abs(10.0 * np.log10(image) - 34.5704) < 6e-5


def test_noise_equivalent_sigma0():
    radar = _radar(transmit_power=500.0, noise_temperature=500.0)
    distance, angle, cell, n = 9.9e3, np.radians(45.0), 0.5, 400
    level = nesz(radar, distance, angle, cell, n)
    area = radar.waveform.range_cell * cell / np.sin(angle)
    # a cell of that sigma0 has an SNR of one after n pulses
    assert np.isclose(snr(radar, level * area, distance, n), 1.0, rtol=1e-12)
    # and the data agree with the equation: peak power of the profile over the noise in it
    peak = radar.amplitude_constant**2 / distance**4
    assert np.isclose(peak, received_power(radar, 1.0, distance), rtol=1e-12)
    assert np.isclose(peak / noise_power(radar, "compressed"), snr(radar, 1.0, distance), rtol=1e-12)
