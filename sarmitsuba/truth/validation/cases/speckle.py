"""Speckle of a focused image: distributions, correlation, looks."""

from functools import cache

import numpy as np
import scipy.fft
from scipy.integrate import simpson

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.units import power_from_db
from sarmitsuba.signal.focusing import focus
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import ground_scene
from sarmitsuba.truth.validation.comparison import CONFIDENCE, CRITICAL_DISTANCE, Case, Comparison

LEVEL_DB = -10.0
# cells per axis: 0.88^2 of their square are kept, 1.1e5 in the full run
CELLS_QUICK, CELLS = 360.0, 400.0
SEED = 5
# unweighted resolution cell on both axes, m
CELL = 1.0


@cache
def ground_image(quick: bool, window: str = "rectangular") -> SarImage:
    """Flat ground in a slant-range image of two pixels per resolution cell on both axes."""
    raw = _ground_echoes(quick)
    return focus(raw, range_window=window, azimuth_window=window)


@cache
def _ground_echoes(quick: bool) -> RawData:
    """Echoes of the ground, traced once for all cases."""
    scene = ground_scene(
        40.0,
        CELL,
        20e3,
        LEVEL_DB,
        n_cells=CELLS_QUICK if quick else CELLS,
        pixel_spacing_azimuth=0.5 * CELL,
        pixel_spacing_range=0.5 * CELL,
    )
    return simulate(scene, seed=SEED)


def amplitude(image: SarImage) -> C128:
    r"""Complex pixels of unit mean power if the ground's sigma0 is right, at baseband; the image's rim is left out.

    Every pixel is seen by the same pulses, so the image's local spectrum drifts with the place; its phase
    :math:`4 \pi |q - A| / \lambda` to the mid-aperture position A is taken out.
    """
    area = image.azimuth_resolution_cell * image.range_resolution_cell / np.sin(image.incidence_angle)
    values = image.total().astype(np.complex128) / np.sqrt(area * power_from_db(LEVEL_DB))
    grid = image.grid
    distance = np.hypot(grid.range[None, :], grid.azimuth[:, None])  # azimuth is measured from mid-aperture
    values = values * np.exp(-4j * np.pi / image.wavelength * distance)
    rows, columns = (round(0.06 * n) for n in values.shape)
    return np.asarray(values[rows:-rows, columns:-columns])


def _steps(image: SarImage) -> tuple[int, int]:
    """Pixels per resolution cell along azimuth and range."""
    return (
        round(image.azimuth_resolution_cell / image.grid.azimuth_spacing),
        round(image.range_resolution_cell / image.grid.range_spacing),
    )


def distributions(quick: bool = False) -> Case:
    """Kolmogorov-Smirnov tests of intensity and phase over independent pixels."""
    image = ground_image(quick)
    step = _steps(image)
    z = amplitude(image)[:: step[0], :: step[1]]
    intensity = np.abs(z) ** 2
    tests = {
        "intensity against exponential of known mean": theory.intensity_test(intensity, mean=1.0),
        "phase against uniform": theory.phase_test(z),
    }
    comparisons = []
    for name, test in tests.items():
        limit = CRITICAL_DISTANCE / np.sqrt(test.n_samples)
        comparisons.append(
            Comparison(
                f"K-S distance, {name}, n = {test.n_samples}",
                np.zeros(1),
                np.zeros(1),
                np.asarray([test.statistic]),
                tolerance=float(limit),
                reason=f"critical distance at {100 * CONFIDENCE:g} %; p = {test.p_value:.3f}",
                unit="",
            )
        )
    level = np.linspace(0.05, 6.0, 60)
    x = np.sort(intensity.ravel())
    empirical = np.searchsorted(x, level) / x.size
    comparisons.append(
        Comparison(
            "distribution of intensity",
            level,
            theory.speckle_cdf(level, 1.0),
            empirical,
            tolerance=float(CRITICAL_DISTANCE / np.sqrt(x.size)),
            reason="as above",
            unit="",
            shown=int(np.argmin(np.abs(level - np.log(2.0)))),
        )
    )
    ratio = float(intensity.mean() / intensity.std())
    comparisons.append(
        Comparison(
            "mean over standard deviation",
            np.ones(1),
            np.ones(1),
            np.asarray([ratio]),
            tolerance=float(4.0 * np.sqrt(2.0 / x.size)),
            reason="4 standard errors, sqrt(2 / n) each",
            unit="",
        )
    )
    return Case(
        name="speckle",
        topic="statistics",
        title="Speckle of one look",
        formula="P(I < x) = 1 - exp(-x / mean), phase uniform",
        source="Goodman, Speckle Phenomena in Optics (2007)",
        x_label="intensity over mean",
        y_label="probability",
        comparisons=tuple(comparisons),
        note=f"{x.size} pixels one resolution cell apart; the mean is sigma0 = -10 dB, not the sample's.",
    )


def correlation(quick: bool = False) -> Case:
    """Complex correlation of neighbouring pixels against the autocorrelation of the impulse response."""
    comparisons = []
    for window in ("rectangular", "hamming"):
        image = ground_image(quick, window)
        z = amplitude(image)
        cells = {
            "azimuth": (0, image.grid.azimuth_spacing, CELL),
            "range": (1, image.grid.range_spacing, CELL),
        }
        for name, (axis, spacing, cell) in cells.items():
            lags = np.arange(9)
            moved = np.moveaxis(z, axis, 0)
            power = np.mean(np.abs(moved) ** 2)
            got = np.array(
                [abs(np.mean(moved[: moved.shape[0] - n] * np.conj(moved[n:]))) / power for n in lags]
            )
            x = np.asarray(lags * spacing / cell, dtype=np.float64)
            n_independent = z.size * 0.25
            comparisons.append(
                Comparison(
                    f"{window}, {name}",
                    x,
                    _window_correlation(window, x),
                    got,
                    tolerance=float(4.0 / np.sqrt(n_independent) + 0.004),
                    reason="4 standard errors of a correlation, and the band's edge on the pulse grid",
                    unit="",
                    shown=1,
                )
            )
    return Case(
        name="correlation",
        topic="statistics",
        title="Spatial correlation of speckle equals that of the impulse response",
        formula="|transform of the squared window|; sinc(lag / cell) without a window",
        source="Goodman (2007); Wiener-Khinchin",
        x_label="lag (resolution cells, unweighted)",
        y_label="modulus of the complex correlation",
        comparisons=tuple(comparisons),
        note="Pixels half a cell apart.",
    )


def _window_correlation(window: str, lag: F64) -> F64:
    """Correlation at lags in unweighted cells: transform of the squared window over the unit band.

    The windows are written out here, independent of those of the focuser.
    """
    u = np.linspace(-0.5, 0.5, 4001)
    w = {"rectangular": np.ones_like(u), "hamming": 0.54 + 0.46 * np.cos(2.0 * np.pi * u)}[window]
    transform = simpson(w**2 * np.exp(2j * np.pi * u * lag[:, None]), x=u, axis=-1)
    return np.asarray(np.abs(transform) / simpson(w**2, x=u))


def looks(quick: bool = False) -> Case:
    """Equivalent number of looks of averaged sub-band images."""
    image = ground_image(quick)
    z = amplitude(image)
    step = _steps(image)
    counts = [(1, 1), (2, 1), (4, 1), (2, 2), (4, 4)]
    got, limit, distance, critical = [], [], [], []
    for n_azimuth, n_range in counts:
        total = None
        parts = [
            part for rows in _split(z, n_azimuth, step[0], 0) for part in _split(rows, n_range, step[1], 1)
        ]
        for part in parts:
            power = np.abs(part) ** 2
            total = power if total is None else total + power
        assert total is not None
        mean = total / len(parts)
        independent = mean[:: step[0] * n_azimuth, :: step[1] * n_range]
        n = independent.size
        count = n_azimuth * n_range
        got.append(theory.equivalent_number_of_looks(independent))
        limit.append(4.0 * count * np.sqrt(2.0 * (1.0 + 1.0 / count) / n + 4.0 / (count * n)))
        test = theory.intensity_test(independent, looks=float(count))
        distance.append(test.statistic * np.sqrt(n))
        critical.append(CRITICAL_DISTANCE)
    number = np.asarray([float(a * b) for a, b in counts])
    return Case(
        name="looks",
        topic="statistics",
        title="L looks give an equivalent number of looks of L",
        formula="ENL = mean^2 / variance = L; intensity gamma distributed",
        source="Goodman (2007)",
        x_label="looks",
        y_label="ENL, or sqrt(n) K-S distance",
        comparisons=(
            Comparison(
                "ENL / L",
                number,
                np.ones(number.size),
                np.asarray(got) / number,
                tolerance=float(np.max(np.asarray(limit) / number)),
                reason="4 standard errors of the largest, 16 looks",
                unit="",
                shown=2,
            ),
            Comparison(
                "sqrt(n) K-S distance to the gamma distribution",
                number,
                np.zeros(number.size),
                np.asarray(distance),
                tolerance=CRITICAL_DISTANCE,
                reason=f"critical value at {100 * CONFIDENCE:g} %",
                unit="",
                shown=2,
            ),
        ),
        note="Looks are equal parts of the azimuth and range bands, 1, 2, 4 and 2 x 2, 4 x 4.",
    )


def _split(z: C128, parts: int, step: int, axis: int) -> list[C128]:
    """Images of equal, disjoint parts of the band that a cell of ``step`` pixels fills."""
    if parts == 1:
        return [z]
    spectrum = scipy.fft.fft(z, axis=axis)
    n = z.shape[axis]
    # the band lies about its centre of energy: range data may carry a constant frequency offset
    moved = np.moveaxis(z, axis, 0)
    center = np.angle(np.vdot(moved[:-1], moved[1:])) / (2.0 * np.pi)
    frequency = (scipy.fft.fftfreq(n) - center + 0.5) % 1.0 - 0.5
    width = 1.0 / step / parts
    images = []
    for i in range(parts):
        low = -0.5 / step + i * width
        keep = (frequency >= low) & (frequency < low + width)
        shape = [1, 1]
        shape[axis] = n
        images.append(np.asarray(scipy.fft.ifft(spectrum * keep.reshape(shape), axis=axis)))
    return images


CASES.register(CaseEntry("speckle", "statistics", distributions))
CASES.register(CaseEntry("correlation", "statistics", correlation))
CASES.register(CaseEntry("looks", "statistics", looks))
