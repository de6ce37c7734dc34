r"""Multilooked intensities of focused images as data of a fit, for scatterers of unknown phase.

With the focusing operator A of a look, the data d and the model m, the intensities :math:`|A d|^2` and :math:`|A m|^2`
are averaged over a Gaussian window and divided by the averaged intensity of the data. Of a displacement only the motion
of the echoes' envelopes counts. A displacement that makes an echo :math:`\rho` farther per unit changes its spectrum by
:math:`-j k \rho`, with :math:`k = 4 \pi (f_c + f) / c`. The part :math:`-j k_c \rho` of the carrier turns the phases
between echoes alone: speckle, which averages out over the window, but with the weight :math:`k_c` per metre. Without it
the average changes by

.. math:: \left\langle 2 \Re (A m)^* A \, \partial m' \right\rangle, \quad \partial m' = \frac{f}{f_c + f} \, \partial m

which for independent echoes is the derivative of the mean intensity. Motion along the track, whose phases turn over the
aperture, is not seen but through the range of another look.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sarmitsuba.apps.fit.confirmation import scales
from sarmitsuba.apps.fit.least_squares import (
    Prior,
    Problem,
    Rows,
    Samples,
    Solution,
    check_determined,
    energy,
    normal_sums,
)
from sarmitsuba.apps.fit.measured_looks import MeasuredLook
from sarmitsuba.apps.fit.shape_offsets import frequencies
from sarmitsuba.core.arrays import C64, F32, F64
from sarmitsuba.signal.focusing.operator import focusing_operator

# widths of the window (full width at half maximum), in range cells, and shares of the step that are taken: coarse to
# fine, then the mean of what the steps say
STAGES: tuple[tuple[float, float], ...] = (
    *((8.0, 1.0),) * 2,
    *((6.0, 1.0),) * 2,
    *((4.0, 1.0),) * 2,
    (3.0, 1.0),
    (3.0, 1.0 / 2.0),
    (3.0, 1.0 / 3.0),
    (3.0, 1.0 / 4.0),
    (3.0, 1.0 / 5.0),
)
# share of the diagonal of the normal equations that damps a step, and its length at most, standard deviations
DAMPING, FARTHEST = 0.05, 3.0
# share of the change over which data stop being straight in a value that a step has at most
STRAIGHT = 0.5
# halvings of a step to values that a scene cannot have
HALVINGS = 20
# least averaged intensity that data are divided by, over the mean of the image
FLOOR = 0.1
# least mean square of relative differences: rounding of float32
LEAST_SQUARE = 2.0**-24
# pixels of a resolution cell
OVERSAMPLED = 2.0
# standard deviations of a Gaussian in its full width at half maximum
FULL_WIDTH = 2.3548


class MultilookedImages(Problem):
    """Averaged intensities of the images of all looks, real.

    Parameters
    ----------
    looks : with data
    width : of the window, range cells
    """

    def __init__(self, looks: Sequence[MeasuredLook], width: float) -> None:
        self.looks, self.names = tuple(looks), looks[0].model.names
        self.images = [_Averaged(look, width) for look in looks]
        self.norms = tuple(float(np.linalg.norm(image.relative(image.measured))) for image in self.images)

    @property
    def pixels(self) -> float:
        """Pixels that are alike, of the first look."""
        return self.images[0].pixels

    def differences(self, values: F64) -> list[Samples]:
        """See the base class."""
        return [
            image.relative(image.measured - image.intensity(look.model.data(values)))
            for look, image in zip(self.looks, self.images, strict=True)
        ]

    def linearise(self, values: F64) -> tuple[list[Samples], list[Rows]]:
        """See the base class."""
        differences: list[Samples] = []
        jacobians: list[Rows] = []
        for look, image in zip(self.looks, self.images, strict=True):
            modelled, derivative = look.model.derivative(values)
            focused = image.focused(modelled)
            rows = [
                image.relative(image.averaged(2.0 * (focused.conj() * image.focused(one)).real))
                for one in envelopes(look, derivative)
            ]
            differences.append(image.relative(image.measured - image.averaged(np.abs(focused) ** 2)))
            jacobians.append(np.array(rows, dtype=np.float32))
        return differences, jacobians

    def variances(self, differences: Sequence[Samples]) -> F64:
        """See the base class; pixels of one window count as one."""
        return np.array(
            [
                2.0 * max(float(np.mean(np.abs(d) ** 2)), LEAST_SQUARE) * image.pixels
                for d, image in zip(differences, self.images, strict=True)
            ]
        )


def window_of(step: int) -> float:
    """Width of the window of a step, counted from 1, range cells."""
    return STAGES[step - 1][0]


def fit_multilooked(
    looks: Sequence[MeasuredLook],
    start: F64,
    known: Mapping[int, Prior],
    iterations: int,
    progress: Callable[[float], None] | None = None,
) -> tuple[Solution, F64]:
    """Values from steps of least squares with windows from coarse to fine, and their covariance.

    The intensities of the model fluctuate as the shapes move, because the echoes of several interfere: no step is asked
    to lower the sum of squares, and the last ones are averaged (stochastic approximation of Robbins and Monro). The
    covariance counts the fluctuations of data and model, before that average.
    """
    values, steps, costs = np.asarray(start, dtype=np.float64), [np.asarray(start)], []
    problems: dict[float, MultilookedImages] = {}
    covariance, change = np.zeros((len(values), len(values))), values
    for width, share in STAGES[:iterations]:
        if width not in problems:
            problems = {width: MultilookedImages(looks, width)}
        problem = problems[width]
        differences, jacobians = problem.linearise(values)
        variances = problem.variances(differences)
        normal, right, normals = normal_sums(jacobians, differences, variances, values, known)
        check_determined(problem.names, normal, known)
        covariance = np.asarray(np.linalg.inv(2.0 * normal), dtype=np.float64)
        sigma = np.sqrt(np.diag(covariance))
        full = np.linalg.solve(normal + DAMPING * np.diag(np.diag(normal)), right)
        scale = scales(looks[0].model.scene, looks[0].model.parameters, values)
        farthest = np.fmin(FARTHEST * sigma, STRAIGHT * scale)
        change = share * np.asarray(np.clip(full, -farthest, farthest), dtype=np.float64)
        for _ in range(HALVINGS):
            if looks[0].model.possible(values + change):
                break
            change = 0.5 * change
        values = values + change
        steps.append(values)
        costs.append(energy(differences) / problem.pixels)
        if progress is not None:
            progress(costs[-1])
    found = bool((np.abs(change) < np.sqrt(np.diag(covariance))).all()) and iterations >= len(STAGES)
    return Solution(values, tuple(steps), differences, normals, tuple(costs), found), covariance


def envelopes(look: MeasuredLook, derivative: C64) -> C64:
    """Derivatives (n_values, channels, pulses, samples), of displacements those without the turn of the carrier."""
    model = look.model
    radar, scene = model.scene.radar, model.scene
    frequency = frequencies(radar.window.n_samples, radar.window.sample_spacing)
    share = frequency / (radar.waveform.center_frequency + frequency)
    out, row = np.array(derivative), 0
    for parameter, own in zip(model.parameters, model.split(model.start), strict=True):
        n = len(own)
        if parameter.moved(scene, own) is not None:
            spectrum = np.fft.fft(derivative[row : row + n], axis=-1)
            out[row : row + n] = np.fft.ifft(spectrum * share, axis=-1)
        row += n
    return out


class _Averaged:
    """Images of one look, averaged over a window."""

    def __init__(self, look: MeasuredLook, width: float) -> None:
        raw = look.residual(look.measured.astype(np.complex128))
        self.operator = focusing_operator(raw)
        across = width * look.model.scene.radar.waveform.range_cell / FULL_WIDTH
        grid = self.operator.grid
        # standard deviations along azimuth and range, pixels
        self.deviations = (across / grid.azimuth_spacing, across / grid.range_spacing)
        # pixels that are alike, by the window and by the image's own resolution
        self.pixels = float(
            np.prod([np.hypot(2.0 * np.sqrt(np.pi) * d, OVERSAMPLED) for d in self.deviations])
        )
        self.measured = self.intensity(look.measured)
        self.scale = self.measured + FLOOR * float(self.measured.mean())

    def focused(self, data: C64) -> C64:
        """Image (channels, azimuth, range)."""
        return np.asarray((self.operator @ data.reshape(-1)).reshape(self.operator.image_shape))

    def averaged(self, intensity: F64 | F32) -> F64:
        """Mean over the window around every pixel."""
        from scipy.ndimage import gaussian_filter

        sigma = (0.0, *self.deviations)
        return np.asarray(gaussian_filter(np.asarray(intensity, dtype=np.float64), sigma, mode="nearest"))

    def intensity(self, data: C64) -> F64:
        """Averaged intensity of the image of data."""
        return self.averaged(np.abs(self.focused(data)) ** 2)

    def relative(self, difference: F64) -> F64:
        """A difference of averaged intensities over those of the data, to which their speckle is proportional."""
        return np.asarray(difference / self.scale)
