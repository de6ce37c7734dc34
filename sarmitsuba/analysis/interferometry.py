"""Interferometry of two images of one scene: phase, coherence and heights.

The spectral shift filter keeps the common band of both images for level ground. Heights follow from the unwrapped
phase by geolocation of pixels from range, Doppler and phase.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from sarmitsuba.analysis.baseline import Baseline, FixedAntennas, Viewpoint
from sarmitsuba.analysis.point_quality import grid_cells, windows_of
from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.registry import late, png_of
from sarmitsuba.signal.image import ImageGrid, SarImage, block_means, block_middles


def common_band_pair(
    image: SarImage, pair: tuple[C128, C128], views: tuple[Viewpoint, Viewpoint], baseline: Baseline
) -> tuple[C128, C128, tuple[float, float]]:
    r"""Both images of a pair filtered to the common wavenumbers of level ground.

    The spectrum of an image is centred at the spatial frequency of its carrier 4 pi R_i / lambda. With the mean of both
    carriers removed, the bands are shifted by half the difference to either side of zero, and the common band is
    centred at zero.

    .. math:: \Delta = \frac{4\pi}{\lambda} \nabla (R_2 - R_1), \qquad W_{common} = W - |\Delta|

    Parameters
    ----------
    image : with the grid, cells and windows of both
    pair : (n_azimuth, n_range) complex128 each
    views : phase centres of both
    baseline : for the error message

    Returns
    -------
    both images filtered, and the remaining share of the band in azimuth and range

    Raises
    ------
    DataError
        There is no common band.

    Notes
    -----
    For level ground at the image plane; the largest shift in the image is removed everywhere. The windows' weights over
    the band are not changed, so that a strong window leaves a small decorrelation.

    References
    ----------
    Gatelli et al., The wavenumber shift in SAR interferometry, IEEE TGRS 32 (1994).
    """
    grid = image.grid
    points = grid.positions() + grid.offset
    near, far = (view.distance(points) for view in views)
    carrier = np.exp(2j * np.pi / image.wavelength * (near + far))
    difference = near - far
    cells = grid_cells(image, grid.shape[1] // 2)
    spacings = (grid.azimuth_spacing, grid.range_spacing)
    share, keep = [], []
    for axis, (cell, spacing, window) in enumerate(zip(cells, spacings, windows_of(image), strict=True)):
        plain = cell / window.broadening
        slope = np.diff(difference, axis=axis) / spacing
        # of the band, cycles per metre times the cell: two-way
        shift = 2.0 / image.wavelength * float(np.abs(slope).max()) * plain if slope.size else 0.0
        if shift >= 1.0:
            raise DataError(
                f"interferogram: no common band: perpendicular baseline {baseline.perpendicular:.4g} m, critical "
                f"{baseline.critical:.4g} m; choose a shorter baseline or the full band"
            )
        share.append(1.0 - shift)
        keep.append(np.abs(scipy.fft.fftfreq(grid.shape[axis], spacing)) * plain <= 0.5 * (1.0 - shift))
    mask = keep[0][:, None] & keep[1]
    one, two = (
        np.asarray(scipy.fft.ifft2(scipy.fft.fft2(values * carrier.conj()) * mask) * carrier)
        for values in pair
    )
    return one, two, (share[0], share[1])


# approximate least number of independent looks in automatic blocks
_LOOKS = 16.0
_NODES = 1024


@dataclass(frozen=True, eq=False)
class Interferogram:
    r"""Interferogram: block mean of the first image times the conjugate second, without the phase of the image plane.

    .. math:: \gamma = \frac{|\langle s_1 s_2^* \rangle|}{\sqrt{\langle |s_1|^2 \rangle \langle |s_2|^2 \rangle}},
              \qquad \phi = \frac{4 \pi}{\lambda} [(R_1(p) - R_1(q)) - (R_2(p) - R_2(q))]

    for a scatterer at q imaged in the pixel at p on the plane; zero for scatterers on the plane.

    Parameters
    ----------
    values : (n_azimuth, n_range) complex128, m^2
    powers : (2, n_azimuth, n_range) float64, m^2, block means of both images
    grid : of the block centres
    wavelength : m
    channel : polarisation
    looks : pixels of a block, azimuth and range
    independent_looks : number of independent samples in a block, real
    views : phase centres of both images
    baseline : at the centre of the grid
    days : from the first image to the second, by ``pass_days`` of their runs; 0 if not recorded

    Notes
    -----
    The sample coherence is biased: for n looks without coherence it is about sqrt(pi / 4n), see
    :func:`sarmitsuba.truth.theory.expected_coherence`. Fringes of the terrain within a block lower it.

    References
    ----------
    Bamler & Hartl, Synthetic aperture radar interferometry, Inverse Problems 14 (1998); Rosen et al., Proc. IEEE 88
    (2000).
    """

    values: C128
    powers: F64
    grid: ImageGrid
    wavelength: float
    channel: str
    looks: tuple[int, int]
    independent_looks: float
    views: tuple[Viewpoint, Viewpoint]
    baseline: Baseline
    days: float = 0.0

    def __repr__(self) -> str:
        return (
            f"Interferogram({self.channel}: {self.grid.shape[0]} x {self.grid.shape[1]} blocks of {self.looks[0]} x "
            f"{self.looks[1]} pixels, perpendicular baseline {self.baseline.perpendicular:.4g} m of "
            f"{self.baseline.critical:.4g} m critical)"
        )

    def _repr_png_(self) -> bytes:
        """Fringes and coherence, for notebooks."""
        return png_of(self.plot())

    def plot(self, heights: object = None) -> object:
        """Fringes, coherence and, if given, a height map as a Matplotlib ``Figure``, which notebooks show."""
        return late("sarmitsuba.view.fringes", "interferogram_figure")(self, heights)

    @property
    def kind(self) -> str:
        """Description of the pair."""
        if self.baseline.passes == 1:
            return "one pass, two receivers"
        days = f" {self.days:g} day{'s' * (self.days != 1.0)} apart" if self.days else ""
        return f"two passes{days}"

    @property
    def phase(self) -> F64:
        """Interferometric phase without the flat-earth phase (image plane), (n_azimuth, n_range) rad, -pi ... pi."""
        return np.asarray(np.angle(self.values))

    @property
    def coherence(self) -> F64:
        """Sample coherence, (n_azimuth, n_range), 0 ... 1; 0 where the power is zero."""
        power = np.sqrt(self.powers[0] * self.powers[1])
        return np.asarray(np.abs(self.values) / np.where(power > 0.0, power, 1.0))

    def positions(self) -> F64:
        """Positions of the blocks on the image plane, (n_azimuth, n_range, 3), m, frame of the user's file."""
        return np.asarray(self.grid.positions() + self.grid.offset)

    def flat_earth_phase(self) -> F64:
        r"""Flat-earth phase: phase of the image plane in images with their carriers, rad, not wrapped.

        .. math:: \phi_{flat} = -\frac{4 \pi}{\lambda} (R_1(p) - R_2(p))
        """
        points = self.positions()
        first, second = (view.distance(points) for view in self.views)
        return np.asarray(-4.0 * np.pi / self.wavelength * (first - second))

    def with_flat_earth(self) -> C128:
        """Values with the flat-earth phase, as for images with their carriers."""
        return np.asarray(self.values * np.exp(1j * self.flat_earth_phase()))

    def vertical_wavenumber(self) -> F64:
        r"""Change of phase per metre of height at constant range and Doppler of the first image, rad/m.

        .. math:: k_z = \frac{4\pi}{\lambda} \nabla R_2 \cdot \frac{\mathbf u}{u_z}, \qquad
                  \mathbf u = \nabla R_1 \times \nabla f_{D1}; \qquad
                  k_z \approx -\frac{2 \pi p B_\perp}{\lambda R \sin\theta}
        """
        return self.height_step()[..., 2]

    def height_step(self) -> F64:
        """East and north displacement per metre of height, and vertical wavenumber, (n_azimuth, n_range, 3)."""
        points = self.positions()
        first, second = (view.look(points) for view in self.views)
        u = np.cross(first.gradient(points), first.sine_gradient(points))
        u = u / u[..., 2:]
        wavenumber = 4.0 * np.pi / self.wavelength * np.sum(second.gradient(points) * u, axis=-1)
        return np.concatenate([u[..., :2], wavenumber[..., None]], axis=-1)

    def as_dict(self) -> dict[str, object]:
        """JSON-able figures."""
        coherence = self.coherence
        return {
            "channel": self.channel,
            "looks": list(self.looks),
            "independent_looks": self.independent_looks,
            "shape": list(self.grid.shape),
            "coherence_median": float(np.median(coherence)),
            "coherence_quartiles": [float(v) for v in np.percentile(coherence, (25, 75))],
            "baseline": self.baseline.as_dict(),
            "days": self.days,
        }


def interferogram(
    first: SarImage,
    second: SarImage,
    looks: tuple[int, int] | None = None,
    *,
    channel: str | None = None,
    band: Literal["full", "common"] = "full",
) -> Interferogram:
    """Interferogram of two images on one grid.

    Parameters
    ----------
    first, second : focused on the same grid, by ``focus(raw, first.grid)`` for the second pass
    looks : averaged pixels in azimuth and range; None: blocks about square on the ground with about 16 or more
        independent samples
    channel : default: the first
    band : ``full``, or ``common``: spectra filtered to the common wavenumbers of level ground, see
        :mod:`sarmitsuba.analysis.interferometry`

    Raises
    ------
    DataError
        The images differ in grid, wavelength or channel, have no scene phases, or no recorded track; the looks do not
        fit; there is no common band.
    """
    channel = channel or first.channels[0]
    check_pair(first, second, channel)
    grid, views = first.grid, (Viewpoint.of(first), Viewpoint.of(second))
    one, two = (image.total(channel).astype(np.complex128) for image in (first, second))
    broadening = windows_of(first)[1].broadening
    middle = grid.positions_on_line(grid.shape[0] // 2)[grid.shape[1] // 2] + grid.offset
    range_cell = first.range_resolution_cell / broadening
    baseline = Baseline.of(views, middle, first.wavelength, range_cell)
    share = (1.0, 1.0)
    if band == "common":
        one, two, share = common_band_pair(first, (one, two), views, baseline)
    block = looks or automatic_looks(first, share)
    if not all(1 <= n <= size for n, size in zip(block, grid.shape, strict=True)):
        raise DataError(
            f"interferogram: looks of {block[0]} x {block[1]} pixels in an image of {grid.shape[0]} x {grid.shape[1]}; "
            "give 1 or more, up to its size"
        )
    product = one * two.conj()
    values = block_means(product.real, block) + 1j * block_means(product.imag, block)
    return Interferogram(
        values=values,
        powers=np.stack([block_means(np.abs(v) ** 2, block) for v in (one, two)]),
        grid=block_grid(grid, block),
        wavelength=first.wavelength,
        channel=channel,
        looks=block,
        independent_looks=independent_looks(first, block, share),
        views=views,
        baseline=baseline,
        days=_days(second) - _days(first),
    )


def _days(image: SarImage) -> float:
    """Days since the first pass, as recorded by the image's run."""
    return float(image.metadata.get("settings", {}).get("pass_days", 0.0))


def check_pair(first: SarImage, second: SarImage, channel: str) -> None:
    """Raise a DataError where two images cannot form an interferogram."""
    for number, image in (("first", first), ("second", second)):
        if channel not in image.channels:
            raise DataError(
                f"interferogram: the {number} image has no channel {channel}, only {', '.join(image.channels)}"
            )
        if image.metadata.get("focus", {}).get("all_round"):
            raise DataError(
                f"interferogram: the {number} image has a circular aperture, no line of sight; choose another mode"
            )
        if image.metadata.get("focus", {}).get("method") == "raster":
            raise DataError(
                f"interferogram: the {number} image is by method raster, with independent speckle in every image; "
                "choose method hybrid, raw or image"
            )
    if not np.isclose(first.wavelength, second.wavelength, rtol=1e-9):
        raise DataError(
            f"interferogram: wavelengths of {first.wavelength:g} m and {second.wavelength:g} m; both images need "
            "the same center_frequency"
        )
    if not same_grid(first.grid, second.grid):
        raise DataError(
            "interferogram: the images have different grids; focus the second's raw data on the first's grid: "
            "focus(raw, first.grid)"
        )


def same_grid(a: ImageGrid, b: ImageGrid) -> bool:
    """Whether two grids have equal pixel positions, to a thousandth of the spacing."""
    if a.kind != b.kind or a.shape != b.shape:
        return False
    other = b.in_frame(a.offset)
    rows, columns = (0, a.shape[0] - 1), (0, a.shape[1] - 1)
    away = [
        np.abs(a.positions_on_line(row)[list(columns)] - other.positions_on_line(row)[list(columns)]).max()
        for row in rows
    ]
    return bool(max(away) < 1e-3 * min(a.azimuth_spacing, a.range_spacing))


def block_grid(grid: ImageGrid, block: tuple[int, int]) -> ImageGrid:
    """Grid of the centres of blocks of pixels."""
    return replace(
        grid, azimuth=block_middles(grid.azimuth, block[0]), range=block_middles(grid.range, block[1])
    )


def automatic_looks(image: SarImage, share: tuple[float, float] = (1.0, 1.0)) -> tuple[int, int]:
    """Pixels of a block about square on the ground with about sixteen cells, at least one pixel each way."""
    grid, column = image.grid, image.grid.shape[1] // 2
    cells = [cell / part for cell, part in zip(grid_cells(image, column), share, strict=True)]
    to_ground = 1.0 if grid.kind == "ground" else 1.0 / float(np.sin(image.incidence_angle[column]))
    side = np.sqrt(_LOOKS * cells[0] * cells[1] * to_ground)
    pixels = (side / grid.azimuth_spacing, side / (grid.range_spacing * to_ground))
    rows, columns = (min(max(1, round(float(n))), size) for n, size in zip(pixels, grid.shape, strict=True))
    return rows, columns


def independent_looks(
    image: SarImage, block: tuple[int, int], share: tuple[float, float] = (1.0, 1.0)
) -> float:
    r"""Equivalent number of independent samples in a block of homogeneous ground.

    .. math:: n = \prod_{axes} \frac{N}{\sum_{|l| < N} (1 - |l| / N) |\rho(l)|^2}

    with rho the correlation of pixels at lag l, from cell and window.

    Parameters
    ----------
    image : with its cells and windows
    block : pixels N, azimuth and range
    share : remaining share of the band, azimuth and range
    """
    cells = grid_cells(image, image.grid.shape[1] // 2)
    spacings = (image.grid.azimuth_spacing, image.grid.range_spacing)
    u = (np.arange(_NODES) + 0.5) / _NODES - 0.5
    found = 1.0
    for n, cell, spacing, window, part in zip(block, cells, spacings, windows_of(image), share, strict=True):
        lag = np.arange(n)
        power = window(u) ** 2 * (np.abs(u) <= 0.5 * part)
        turns = np.outer(lag * spacing * window.broadening / cell, u)
        rho = np.abs(np.exp(2j * np.pi * turns) @ power) / power.sum()
        weight = np.where(lag == 0, 1.0, 2.0 * (1.0 - lag / n))
        found *= n / float(np.sum(weight * rho**2))
    return found


# steps of Newton's method; each squares the error
_ROUNDS = 4
# least change of phase per metre of height, rad
_LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Scene points of all blocks of an interferogram.

    Parameters
    ----------
    points : (n_azimuth, n_range, 3) float64, m, frame of the user's file: x, y, z; NaN in known shadow
    phase : (n_azimuth, n_range) float64, rad, of the points
    sigma : (n_azimuth, n_range) float64, m; standard deviation of z from coherence and looks
    coherence : (n_azimuth, n_range)
    height_of_ambiguity : m, at the grid's middle

    Notes
    -----
    In layover, where several surfaces share range and Doppler, the point lies between them, weighted by their power; in
    shadow that is not known, it is meaningless.
    """

    points: F64
    phase: F64
    sigma: F64
    coherence: F64
    height_of_ambiguity: float

    @property
    def z(self) -> F64:
        """Heights of the points, (n_azimuth, n_range) float64, m."""
        return self.points[..., 2]

    def __repr__(self) -> str:
        return f"HeightMap({self.z.shape[0]} x {self.z.shape[1]}, ambiguity {self.height_of_ambiguity:.4g} m)"


def unwrapped_phase(pair: Interferogram, least_coherence: float = 0.3) -> F64:
    """Unwrapped phase, rad; NaN where the coherence is below ``least_coherence``.

    By reliability sorting (Herraez et al., Applied Optics 41, 2002) from scikit-image. The multiple of 2 pi is chosen
    so that the median lies in -pi ... pi: most of the scene is assumed to be near the image plane.

    Raises
    ------
    DataError
        scikit-image is not installed, or all blocks are less coherent.

    Notes
    -----
    Steps of more than half the height of ambiguity between neighbours, such as tall walls, are unwrapped wrongly.
    """
    try:
        from skimage.restoration import unwrap_phase
    except ImportError as error:
        raise DataError(
            "interferogram: unwrapping needs scikit-image; pip install 'sarmitsuba[interferometry]'"
        ) from error
    low = pair.coherence < least_coherence
    if low.all():
        raise DataError(
            f"interferogram: no block has a coherence of {least_coherence:g}; lower the bound or use more looks"
        )
    found = np.ma.filled(unwrap_phase(np.ma.masked_array(pair.phase, mask=low), rng=0), np.nan)
    turns = np.round(np.nanmedian(found) / (2.0 * np.pi))
    return np.asarray(found - 2.0 * np.pi * turns, dtype=np.float64)


def height_map(
    pair: Interferogram,
    phase: F64 | None = None,
    *,
    lowest: float | None = None,
    shadow: NDArray[np.bool_] | None = None,
) -> HeightMap:
    r"""Position and height of every block: the point q with its range, Doppler and phase.

    .. math:: R_1(q) = R_1(p), \quad f_{D1}(q) = f_{D1}(p), \quad
              R_2(q) = R_2(p) + \frac{\lambda \phi}{4 \pi}

    Parameters
    ----------
    pair : the interferogram
    phase : (n_azimuth, n_range) rad, such as :func:`unwrapped_phase`; None: the wrapped phase, for heights from
        ``lowest`` to one height of ambiguity above it
    lowest : m, frame of the user's file; None: a tenth of the height of ambiguity below the image plane
    shadow : (n_azimuth, n_range) blocks in radar shadow, which get no height; None: not known

    Raises
    ------
    DataError
        There is no perpendicular baseline.

    References
    ----------
    Madsen, Zebker & Martin, IEEE TGRS 31 (1993): position from range sphere, Doppler cone and phase cone.
    """
    step = pair.height_step()
    wavenumber = step[..., 2]
    ambiguity = pair.baseline.height_of_ambiguity
    if np.abs(wavenumber).min() < _LEAST or not np.isfinite(ambiguity):
        raise DataError(
            f"interferogram: heights need a perpendicular baseline; it is {pair.baseline.perpendicular:g} m"
        )
    plane = pair.grid.height + float(pair.grid.offset[2])
    if phase is None:
        low = -0.1 * ambiguity if lowest is None else lowest - plane
        turn = np.mod(pair.phase * np.sign(wavenumber) - low * np.abs(wavenumber), 2.0 * np.pi)
        phase = (turn + low * np.abs(wavenumber)) * np.sign(wavenumber)
    points = pair.positions()
    first, second = (view.look(points) for view in pair.views)
    wanted = (
        first.distance(points),
        first.sine(points),
        second.distance(points) + pair.wavelength / (4.0 * np.pi) * phase,
    )
    z = phase / wavenumber
    if shadow is not None:
        z = np.where(shadow, np.nan, z)
    place = points + np.stack([step[..., 0] * z, step[..., 1] * z, z], axis=-1)
    known = np.isfinite(z)
    place[~known] = points[~known]
    for _ in range(_ROUNDS):
        place = place - _correction(first, second, place, wanted, known)
    place[~known] = np.nan
    coherence = pair.coherence
    return HeightMap(
        points=place,
        phase=phase,
        sigma=np.where(known, phase_sigma(coherence, pair.independent_looks) / np.abs(wavenumber), np.nan),
        coherence=coherence,
        height_of_ambiguity=ambiguity,
    )


def _correction(
    first: FixedAntennas,
    second: FixedAntennas,
    place: F64,
    wanted: tuple[F64, F64, F64],
    known: NDArray[np.bool_],
) -> F64:
    """Newton step towards points of given range, sine and second range; zero where these are undefined."""
    missed = [
        found - value
        for found, value in zip(
            (first.distance(place), first.sine(place), second.distance(place)), wanted, strict=True
        )
    ]
    rows = (first.gradient(place), first.sine_gradient(place), second.gradient(place))
    # scale the last two rows: the gradient of a sine is of order 1 / range, the gradients of both ranges differ little
    scale = first.distance(place)
    matrix = np.stack([rows[0], rows[1] * scale[..., None], (rows[2] - rows[0]) * scale[..., None]], axis=-2)
    right = np.stack([missed[0], missed[1] * scale, (missed[2] - missed[0]) * scale], axis=-1)
    right[~known] = 0.0
    return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0])


def phase_sigma(coherence: F64, looks: float) -> F64:
    r"""Standard deviation of the phase, rad: the Cramer-Rao bound, at most that of a uniform phase.

    .. math:: \sigma_\phi = \min\left(\sqrt{\frac{1 - \gamma^2}{2 n \gamma^2}}, \frac{\pi}{\sqrt 3}\right)

    Rodriguez & Martin, IEE Proc. F 139 (1992); valid for more than about four looks.
    """
    square = np.clip(coherence, 1e-6, 1.0) ** 2
    return np.asarray(np.minimum(np.sqrt((1.0 - square) / (2.0 * looks * square)), np.pi / np.sqrt(3.0)))
