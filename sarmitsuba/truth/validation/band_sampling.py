"""Radar bands of the validation cases and how finely their targets are sampled."""

from sarmitsuba.core.constants import SPEED_OF_LIGHT

# centre frequencies of the usual radar bands, Hz
BANDS = {"L": 1.27e9, "C": 5.405e9, "X": 9.65e9, "Ka": 35.0e9}
# sides, m: at least 8 wavelengths, for which physical optics holds to 0.1 dB; different in each band
PLATE_SIDE = {"L": 2.0, "C": 1.0, "X": 1.0, "Ka": 0.3}
# rays across a target at least: where 4.5 per wavelength are fewer than this, its rim is coarse and not its phase
RAYS_ACROSS = 128
RIM = f"rim resolved to the ray spacing: 4.5 rays per wavelength, {RAYS_ACROSS} across the target at least"


def wavelength(band: str) -> float:
    """Wavelength of a band, m."""
    return SPEED_OF_LIGHT / BANDS[band]


def bands(quick: bool) -> tuple[str, ...]:
    """Return the bands of a run."""
    return ("X",) if quick else ("L", "C", "X", "Ka")


def spacing(lam: float, size: float) -> float:
    """Ray spacing of the canonical cases, m."""
    return min(lam / 4.5, size / RAYS_ACROSS)


X_BAND = BANDS["X"]
X_WAVELENGTH = wavelength("X")
