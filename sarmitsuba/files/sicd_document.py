"""XML document of a SICD 1.3 file.

The library sarkit provides the schema, this module the values. Source: NGA.STND.0024-1_1.3.0,
Sensor Independent Complex Data, design and implementation description.

A ``ground`` grid is a uniform grid in a plane (``PLANE``), a ``slant`` grid one in range and zero-Doppler time
(``RGZERO``). Rows increase away from the radar; columns so that the image is a view from above: along the flight for a
right-looking radar, against it for a left-looking one.
"""

from __future__ import annotations

import datetime
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.files.nga import (
    LETTERS,
    MODE_TYPES,
    OTHER_MODE,
    Element,
    polarisations,
    read_utc,
    set_utc,
    whole_microseconds,
)
from sarmitsuba.radar.collection import Collection, Flight, Signal
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.signal.image import UNCALIBRATED, ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.version import __version__

if TYPE_CHECKING:
    import lxml.etree


UP = np.array([0.0, 0.0, 1.0])

NAMESPACE = "urn:SICD:1.3.0"
# least cosine of the inclination of a level plane, and largest acceleration, m / s^2, of a straight track
_LEVEL, _STRAIGHT = 0.9999, 1e-6
# half-power over noise-equivalent width of a uniform band; for the usual windows within 3 %
_UNIFORM_WIDTH = 0.885892941378905


@dataclass(frozen=True, eq=False)
class Axes:
    """Directions, spacings and spatial frequencies of a file's rows and columns.

    Parameters
    ----------
    scp : (3,) m, file frame; scene centre point, at ``pixel``
    pixel : row and column of the scene centre point
    turned : whether columns increase against the flight
    units : (2, 3) unit vectors of rows and columns, file frame
    spacing : m, of rows and columns
    carrier : cycles/m, centre of the pixels' spatial frequencies along rows and columns
    bandwidth : cycles/m
    """

    scp: F64
    pixel: tuple[int, int]
    turned: bool
    units: F64
    spacing: tuple[float, float]
    carrier: tuple[float, float]
    bandwidth: tuple[float, float]

    @staticmethod
    def of(image: SarImage, flight: Collection) -> Axes:
        """Axes of an image's pixels, with its central pixel as scene centre point."""
        grid = image.grid.in_frame(np.zeros(3))
        middle = (grid.shape[0] // 2, grid.shape[1] // 2)
        scp = grid.positions_on_line(middle[0])[middle[1]]
        turned = flight.signal.look_side == "left"
        column = -grid.along if turned else grid.along
        time = center_time(flight, grid.along, scp)
        antenna, velocity = flight.state(time)
        line = (scp - antenna) / np.linalg.norm(scp - antenna)
        wave = 2.0 * flight.signal.center_frequency / SPEED_OF_LIGHT
        if grid.kind == "ground":
            row = grid.across
            carrier = (wave * float(line @ row), wave * float(line @ column))
        else:  # zero Doppler: the slant range direction at closest approach
            forward = velocity / np.linalg.norm(velocity)
            away = scp - antenna
            row = away - forward * (away @ forward)
            row = row / np.linalg.norm(row)
            column = -forward if turned else forward
            carrier = (wave * float(line @ row), wave * float(line @ column))
        range_band = 2.0 * flight.signal.bandwidth / SPEED_OF_LIGHT * float(line @ row)
        last = grid.shape[0] - 1
        return Axes(
            scp,
            (middle[1], last - middle[0] if turned else middle[0]),
            turned,
            np.stack([row, column]),
            (grid.range_spacing, grid.azimuth_spacing),
            carrier,
            (
                range_band,
                1.0 / image.azimuth_resolution_cell,
            ),
        )

    def ramp(self, shape: tuple[int, int]) -> tuple[F64, F64]:
        """Carrier phase, cycles, at every row and column of an array."""
        rows, columns = (
            np.asarray((np.arange(n) - at) * step * k, dtype=np.float64)
            for n, at, step, k in zip(shape, self.pixel, self.spacing, self.carrier, strict=True)
        )
        return rows, columns


def center_time(flight: Collection, along: F64, point: F64) -> float:
    """Time of the centre of a point's aperture, s from the first pulse."""
    middle = 0.5 * flight.duration
    if not flight.own_apertures:
        return middle
    _, velocity = flight.state(middle)
    return middle + float((point - np.asarray(flight.signal.aim_point)) @ along) / float(velocity @ along)


def document(image: SarImage, channel: str, flight: Collection, name: str) -> lxml.etree._ElementTree:
    """SICD XML tree of one channel of an image.

    Parameters
    ----------
    image : on the grid of ``axes``
    channel : polarisation, transmit first
    flight : of the radar
    name : of the image
    """
    import lxml.etree
    import sarkit.sicd

    root = lxml.etree.Element(f"{{{NAMESPACE}}}SICD", nsmap={None: NAMESPACE})
    tree = lxml.etree.ElementTree(root)
    top: Element = sarkit.sicd.ElementWrapper(root)
    axes = Axes.of(image, flight)
    top["CollectionInfo"] = {
        "CollectorName": "sarmitsuba",
        "CoreName": name,
        "CollectType": "MONOSTATIC",
        "RadarMode": {"ModeType": MODE_TYPES.get(flight.signal.mode, OTHER_MODE)},
        "Classification": "UNCLASSIFIED",
    }
    top["ImageCreation"] = {
        "Application": f"sarmitsuba {__version__}",
        "DateTime": datetime.datetime.now(datetime.timezone.utc),
    }
    rows, columns = image.grid.shape[::-1]
    top["ImageData"] = {
        "PixelType": "RE32F_IM32F",
        "NumRows": rows,
        "NumCols": columns,
        "FirstRow": 0,
        "FirstCol": 0,
        "FullImage": {"NumRows": rows, "NumCols": columns},
        "SCPPixel": np.array(axes.pixel),
    }
    _geo_data(top, image, axes)
    _grid(top, image, axes, flight)
    duration = flight.duration + 1.0 / flight.pulse_rate  # the last pulse's interval included
    top["Timeline"] = {
        "CollectStart": whole_microseconds(flight.start),
        "CollectDuration": duration,
        "IPP": {
            "@size": 1,
            "Set": [
                {
                    "@index": 1,
                    "TStart": 0.0,
                    "TEnd": duration,
                    "IPPStart": 0,
                    "IPPEnd": flight.signal.pulses - 1,
                    "IPPPoly": np.array([0.0, flight.pulse_rate]),
                }
            ],
        },
    }
    set_utc(root, "Timeline/CollectStart", flight.start)
    anchor = image.anchor
    position = flight.polynomial() @ anchor.axes
    position[0] += anchor.origin
    top["Position"] = {"ARPPoly": position}
    _signal(top, channel, flight, "RMA" if image.grid.kind == "slant" else "OTHER")
    scp_coa = sarkit.sicd.compute_scp_coa(tree)
    root.append(scp_coa)
    if image.calibrated:
        top["Radiometric"] = {"RCSSFPoly": np.array([[1.0]])}
    if image.grid.kind == "slant":
        _range_migration(top, axes, flight)
    return tree


def _geo_data(top: Element, image: SarImage, axes: Axes) -> None:
    anchor, grid = image.anchor, image.grid.in_frame(np.zeros(3))
    geodetic = anchor.to_geodetic(axes.scp)
    last = grid.shape[0] - 1
    first, final = (last, 0) if axes.turned else (0, last)
    near_first, far_first = grid.positions_on_line(first)[[0, -1]]
    near_last, far_last = grid.positions_on_line(final)[[0, -1]]
    corners = anchor.to_geodetic(np.stack([near_first, near_last, far_last, far_first]))
    top["GeoData"] = {
        "EarthModel": "WGS_84",
        "SCP": {
            "ECF": anchor.to_ecef(axes.scp),
            "LLH": np.array([*np.degrees(geodetic[:2]), geodetic[2]]),
        },
        "ImageCorners": np.degrees(corners[:, :2]),
    }


def _grid(top: Element, image: SarImage, axes: Axes, flight: Collection) -> None:
    along = image.grid.along
    poly = np.array([[center_time(flight, along, axes.scp)]])
    if flight.own_apertures:
        _, velocity = flight.state(0.5 * flight.duration)
        poly = np.array([[poly[0, 0], float(axes.units[1] @ along) / float(velocity @ along)]])
    grid: dict[str, object] = {
        "ImagePlane": "GROUND" if image.grid.kind == "ground" else "SLANT",
        "Type": "PLANE" if image.grid.kind == "ground" else "RGZERO",
        "TimeCOAPoly": poly,
    }
    # noise-equivalent cells: that of slant range projected onto the rows
    slant = 2.0 * flight.signal.bandwidth / SPEED_OF_LIGHT
    cells = (image.range_resolution_cell * slant / axes.bandwidth[0], image.azimuth_resolution_cell)
    for i, name in enumerate(("Row", "Col")):
        band = axes.bandwidth[i]
        grid[name] = {
            "UVectECF": axes.units[i] @ image.anchor.axes,
            "SS": axes.spacing[i],
            "ImpRespWid": _UNIFORM_WIDTH * cells[i],
            "Sgn": -1,
            "ImpRespBW": band,
            "KCtr": axes.carrier[i],
            "DeltaK1": -0.5 * band,
            "DeltaK2": 0.5 * band,
        }
    top["Grid"] = grid


def _signal(top: Element, channel: str, flight: Collection, algorithm: str) -> None:
    signal = flight.signal
    low, high = (signal.center_frequency + sign * 0.5 * signal.bandwidth for sign in (-1.0, 1.0))
    transmitted, received = polarisations(channel, str(top["CollectionInfo"]["CoreName"]))
    both = f"{transmitted}:{received}"
    top["RadarCollection"] = {
        "TxFrequency": {"Min": low, "Max": high},
        "Waveform": {
            "@size": 1,
            "WFParameters": [
                {
                    "@index": 1,
                    "TxPulseLength": signal.pulse_width,
                    "TxRFBandwidth": signal.bandwidth,
                    "TxFreqStart": low,
                    "TxFMRate": signal.bandwidth / signal.pulse_width,
                    "ADCSampleRate": signal.sampling_rate,
                }
            ],
        },
        "TxPolarization": transmitted,
        "RcvChannels": {"@size": 1, "ChanParameters": [{"@index": 1, "TxRcvPolarization": both}]},
    }
    top["ImageFormation"] = {
        "RcvChanProc": {"NumChanProc": 1, "ChanIndex": [1]},
        "TxRcvPolarizationProc": both,
        "TStartProc": 0.0,
        "TEndProc": flight.duration,
        "TxFrequencyProc": {"MinProc": low, "MaxProc": high},
        "ImageFormAlgo": algorithm,
        "STBeamComp": "NO",
        "ImageBeamComp": "NO",
        "AzAutofocus": "NO",
        "RgAutofocus": "NO",
    }


def _range_migration(top: Element, axes: Axes, flight: Collection) -> None:
    """Range and time of closest approach of the pixels of a slant grid, for a straight track."""
    middle = 0.5 * flight.duration
    position, velocity = flight.state(middle)
    speed = float(np.linalg.norm(velocity))
    away = axes.scp - position
    ahead = float(away @ velocity) / speed
    top["RMA"] = {
        "RMAlgoType": "OMEGA_K",
        "ImageType": "INCA",
        "INCA": {
            "TimeCAPoly": np.array([middle + ahead / speed, (-1.0 if axes.turned else 1.0) / speed]),
            "R_CA_SCP": float(np.sqrt(away @ away - ahead**2)),
            "FreqZero": flight.signal.center_frequency,
            "DRateSFPoly": np.array([[1.0]]),
        },
    }


def image_of(top: Element, pixels: C64, what: str) -> SarImage:
    """Image of a SICD document and its pixels, in a frame (east, north, up) whose level plane is the image plane.

    Parameters
    ----------
    top : root of the document, an ``ElementWrapper``
    pixels : (rows, columns) complex64
    what : start of every error message
    """
    latitude, longitude, height = top["GeoData"]["SCP"]["LLH"]
    anchor = Anchor.of_degrees(latitude, longitude, height)
    kind = _kind(top, what)
    anchor = _level_anchor(top, anchor, kind, what)
    row, column = (anchor.axes @ top["Grid"][name]["UVectECF"] for name in ("Row", "Col"))
    flight = _collection(top, anchor)
    antenna, velocity = flight.state(float(top["Grid"]["TimeCOAPoly"][0, 0]))
    turned = bool(column @ velocity < 0.0)
    along = -column if turned else column
    scp = anchor.from_ecef(top["GeoData"]["SCP"]["ECF"])
    axes = Axes(
        scp,
        (int(top["ImageData"]["SCPPixel"][0]), int(top["ImageData"]["SCPPixel"][1])),
        turned,
        np.stack([row, column]),
        _pair(top, "SS"),
        _pair(top, "KCtr"),
        _pair(top, "ImpRespBW"),
    )
    rows, columns = axes.ramp(pixels.shape)
    calibrated = top.elem.find("{*}Radiometric/{*}RCSSFPoly") is not None
    scale = float(np.sqrt(_constant(top["Radiometric"]["RCSSFPoly"] if calibrated else None, what)))
    data = pixels * (scale * np.exp(2j * np.pi * rows))[:, None] * np.exp(2j * np.pi * columns)
    data = data.T[::-1] if turned else data.T
    first = pixels.shape[1] - 1 - axes.pixel[1] if turned else axes.pixel[1]
    azimuth, ranges = (
        np.asarray((np.arange(n) - at) * step, dtype=np.float64)
        for n, at, step in zip(pixels.shape[::-1], (first, axes.pixel[0]), axes.spacing[::-1], strict=True)
    )
    origin, across = scp, row
    if kind == "slant":
        forward = velocity / np.linalg.norm(velocity)
        origin, along = antenna, forward
        azimuth = azimuth + float((scp - antenna) @ forward)
        ranges = ranges + float(top["RMA"]["INCA"]["R_CA_SCP"])
        across = np.cross(forward, UP) * (1.0 if flight.signal.look_side == "right" else -1.0)
    grid = ImageGrid(kind, azimuth, ranges, origin, along, across, float(scp[2]), anchor=anchor)
    line = grid.positions_on_line(azimuth.size // 2) - antenna
    slant = 2.0 * flight.signal.bandwidth / SPEED_OF_LIGHT
    widths = [float(top["Grid"][name]["ImpRespWid"]) / _UNIFORM_WIDTH for name in ("Row", "Col")]
    letters = str(top["ImageFormation"]["TxRcvPolarizationProc"]).split(":")
    if any(name not in LETTERS for name in letters):
        raise DataError(
            f"{what}: polarisation {':'.join(letters)} is not supported; supported: H, V, RHC, LHC"
        )
    channel = "".join(LETTERS[name] for name in letters)
    return SarImage(
        data=data[None].astype(np.complex64),
        layers=(Layer(channel),),
        grid=grid,
        wavelength=SPEED_OF_LIGHT / flight.signal.center_frequency,
        azimuth_resolution_cell=widths[1],
        range_resolution_cell=widths[0] * axes.bandwidth[0] / slant,
        incidence_angle=np.arccos(-line[:, 2] / np.linalg.norm(line, axis=1)),
        metadata={
            **({} if calibrated else UNCALIBRATED),
            "source": what,
            "scene": str(top["CollectionInfo"]["CoreName"]),
            "focus": {
                "center_position": [float(v) for v in antenna],
                "flight": flight.flight.as_dict(),
                "signal": asdict(flight.signal),
            },
        },
    )


def _level_anchor(top: Element, anchor: Anchor, kind: str, what: str) -> Anchor:
    """Anchor, within kilometres, whose level plane is the image plane; for slant range the plane of the flight."""
    if kind == "ground":
        normal = np.cross(*(top["Grid"][name]["UVectECF"] for name in ("Row", "Col")))
    else:
        forward = top["SCPCOA"]["ARPVel"] / np.linalg.norm(top["SCPCOA"]["ARPVel"])
        normal = anchor.axes[2] - float(anchor.axes[2] @ forward) * forward
    normal = normal / np.linalg.norm(normal)
    if float(normal @ anchor.axes[2]) < _LEVEL:
        raise DataError(
            f"{what}: inclined image planes are not supported; supported: level planes and slant range"
        )
    return Anchor(float(np.arcsin(normal[2])), float(np.arctan2(normal[1], normal[0])), anchor.height)


def _pair(top: Element, name: str) -> tuple[float, float]:
    """Parameter of rows and columns."""
    return float(top["Grid"]["Row"][name]), float(top["Grid"]["Col"][name])


def _kind(top: Element, what: str) -> Literal["ground", "slant"]:
    plane, kind = top["Grid"]["ImagePlane"], top["Grid"]["Type"]
    if kind == "PLANE" and plane == "GROUND":
        return "ground"
    straight = np.abs(np.asarray(top["Position"]["ARPPoly"])[2:]).max(initial=0.0) < _STRAIGHT
    if kind == "RGZERO" and straight:
        return "slant"
    raise DataError(
        f"{what}: a grid of type {kind} in the {plane} plane is not supported; supported: PLANE in the GROUND plane, "
        "and RGZERO of a straight track"
    )


def _constant(poly: F64 | None, what: str) -> float:
    """Single coefficient of a polynomial; 1 where it is missing."""
    if poly is None:
        return 1.0
    if np.asarray(poly).size > 1:
        raise DataError(
            f"{what}: a radar cross section factor that varies over the image (RCSSFPoly) is not supported"
        )
    return float(np.asarray(poly).ravel()[0])


def _collection(top: Element, anchor: Anchor) -> Collection:
    position = np.array(top["Position"]["ARPPoly"], dtype=np.float64)
    position[0] -= anchor.origin
    wave = top["RadarCollection"]["Waveform"]["WFParameters"][0]
    low, high = (float(top["ImageFormation"]["TxFrequencyProc"][name]) for name in ("MinProc", "MaxProc"))
    pulses = top["Timeline"]["IPP"]["Set"][0]
    rate = float(pulses["IPPPoly"][1])
    duration = float(top["Timeline"]["CollectDuration"]) - 1.0 / rate
    aperture = duration
    if np.asarray(top["Grid"]["TimeCOAPoly"]).size > 1:
        speed, distance = np.linalg.norm(top["SCPCOA"]["ARPVel"]), float(top["SCPCOA"]["SlantRange"])
        length = SPEED_OF_LIGHT / (low + high) * distance * float(top["Grid"]["Col"]["ImpRespBW"])
        aperture = min(duration, length / float(speed))
    kinds = {text: mode for mode, text in MODE_TYPES.items() if mode != "circular"}
    center, rows = 0.5 * duration, position @ anchor.axes.T
    middle = np.asarray(np.polynomial.polynomial.polyval(center, rows))
    rows[0] -= middle
    series = [
        np.polynomial.Polynomial(one).convert(kind=np.polynomial.Chebyshev, domain=[0.0, duration]).coef
        for one in rows.T
    ]
    size = max(one.size for one in series)
    flight = Flight(
        middle,
        np.asarray(np.polynomial.polynomial.polyval(center, np.polynomial.polynomial.polyder(rows))),
        (0.0, center, duration),
        np.stack([np.pad(one, (0, size - one.size)) for one in series], axis=1),
        read_utc(top.elem, "Timeline/CollectStart"),
    )
    signal = Signal(
        mode=kinds.get(str(top["CollectionInfo"]["RadarMode"]["ModeType"]), "spotlight"),
        look_side="left" if top["SCPCOA"]["SideOfTrack"] == "L" else "right",
        pulses=int(pulses["IPPEnd"]) - int(pulses["IPPStart"]) + 1,
        aperture=aperture,
        aim_point=(0.0, 0.0, 0.0),
        center_frequency=0.5 * (low + high),
        bandwidth=high - low,
        sampling_rate=float(wave["ADCSampleRate"]),
        pulse_width=float(wave["TxPulseLength"]),
    )
    return Collection(signal, flight)
