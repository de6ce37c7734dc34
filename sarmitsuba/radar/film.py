"""Description of the receive window and the image: the parameters of ``range_film``, typed."""

from dataclasses import dataclass
from typing import Literal

from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import ParamTable, declare_field, knows_its_fields, params_of


@knows_its_fields
@dataclass(frozen=True, kw_only=True)
class FilmDescription:
    """Receive window and sampling of the echoes, and the image to focus from them; units as `RadarDescription`."""

    near_range: float = declare_field(
        0.0,
        "slant range of the first sample at mid-aperture; automatic: from image and geometry",
        "m",
        0.0,
        1e9,
        auto=True,
    )
    far_range: float = declare_field(
        0.0,
        "slant range of the last sample at mid-aperture; automatic: from image and geometry",
        "m",
        0.0,
        1e9,
        auto=True,
    )
    sampling_rate: float = declare_field(
        0.0,
        "complex samples per second; automatic: 1.2 times the bandwidth",
        "Hz",
        0.0,
        1e13,
        auto=True,
    )
    gridding_width: int = declare_field(
        4,
        "width in samples of the gridding kernel; each step of 1 gains about 10 dB of accuracy",
        "",
        2,
        8,
    )
    image_grid: Literal["slant", "ground"] = declare_field(
        "slant", "coordinates of the image", choices=("slant", "ground")
    )
    image_center_x: float | None = declare_field(
        None,
        "image centre, east, in the file's frame; default: the aim point, or the middle of the geometry with its "
        "layover where image_extent_range is automatic",
        "m",
        -1e9,
        1e9,
    )
    image_center_y: float | None = declare_field(
        None, "image centre, north, in the file's frame; default: as image_center_x", "m", -1e9, 1e9
    )
    image_height: float | None = declare_field(
        None,
        "height of the horizontal image plane in the file's frame; default: that of the aim point",
        "m",
        -1e9,
        1e9,
    )
    image_extent_azimuth: float = declare_field(
        0.0,
        "image size along the track, on the ground; automatic: the geometry with a margin, at most "
        "image_extent_limit",
        "m",
        0.0,
        1e7,
        auto=True,
    )
    image_extent_range: float = declare_field(
        0.0,
        "image size across the track, on the ground; automatic: the geometry with its layover and a margin, at "
        "most image_extent_limit",
        "m",
        0.0,
        1e7,
        auto=True,
    )
    image_extent_limit: float = declare_field(
        0.0, "largest automatic extent; automatic: 2048 resolution cells", "m", 0.0, 1e7, auto=True
    )
    pixel_spacing_azimuth: float = declare_field(
        0.0, "pixel spacing along the track; automatic: half the azimuth cell", "m", 0.0, 1e6, auto=True
    )
    pixel_spacing_range: float = declare_field(
        0.0,
        "pixel spacing in slant range or on the ground, as image_grid says; automatic: half the range cell",
        "m",
        0.0,
        1e6,
        auto=True,
    )
    pixels_azimuth: int = declare_field(
        0,
        "number of pixels along the track, in place of image_extent_azimuth; automatic: as many as cover that",
        "",
        0,
        1_000_000,
        auto=True,
    )
    pixels_range: int = declare_field(
        0,
        "number of pixels in range, in place of image_extent_range; automatic: as many as cover that",
        "",
        0,
        1_000_000,
        auto=True,
    )


FILM = ParamTable(
    plugin="range_film",
    element="film",
    doc="Receive window and sampling of the echoes, and the image to focus from them.",
    error=RadarError,
    hints={
        "width": "the image is given by image_extent_range and pixel_spacing_range",
        "height": "the image is given by image_extent_azimuth and pixel_spacing_azimuth",
    },
    params=params_of(FilmDescription),
)
