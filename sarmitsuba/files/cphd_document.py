"""XML document of a CPHD 1.1 file.

The library sarkit provides the schema, this module the values. Source: NGA.STND.0068-1_1.1.0,
Compensated Phase History Data, design and implementation description.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.files.nga import MODE_TYPES, OTHER_MODE, Element, polarisations, set_utc, whole_microseconds
from sarmitsuba.version import __version__

if TYPE_CHECKING:
    import lxml.etree

    from sarmitsuba.radar.geodesy import Anchor


PROFILE = "sarmitsuba"  # of files with calibrated amplitudes, in ProductInfo
NAMESPACE = "http://api.nsgreg.nga.mil/schema/cphd/1.1.0"
# per-vector parameters in the order of the file: name, numbers of 8 bytes
LAYOUT = (
    ("TxTime", 1),
    ("TxPos", 3),
    ("TxVel", 3),
    ("RcvTime", 1),
    ("RcvPos", 3),
    ("RcvVel", 3),
    ("SRPPos", 3),
    ("aFDOP", 1),
    ("aFRR1", 1),
    ("aFRR2", 1),
    ("FX1", 1),
    ("FX2", 1),
    ("TOA1", 1),
    ("TOA2", 1),
    ("TDTropoSRP", 1),
    ("SC0", 1),
    ("SCSS", 1),
    ("SIGNAL", 1),
)
VECTOR_BYTES = 8 * sum(size for _, size in LAYOUT)


@dataclass(frozen=True, eq=False)
class GroundArea:
    """Imaged rectangle of the ground.

    Parameters
    ----------
    origin : (3,) float64, m, file frame; scene reference point
    axes : (2, 3) horizontal unit vectors, the first along the flight, right-handed with up
    low, high : (2,) float64, m, corners along the axes from the origin
    spacing : (2,) m, pixel spacing of its image
    """

    origin: F64
    axes: F64
    low: F64
    high: F64
    spacing: F64


@dataclass(frozen=True, eq=False)
class CphdRecording:
    """Content of the document.

    Parameters
    ----------
    name : of the collection
    mode : of the radar
    bistatic : whether the receiver is separate from the transmitter
    channels : polarisations, transmit first
    vectors : (n_pulses,) structured array of per-vector parameters
    n_samples : frequencies per vector
    area : of the ground
    anchor : geodetic position of the file frame's origin
    dwell : s; centre of dwell at the scene reference point, its slope along the flight in s/m, and dwell time
    facts : further values by name
    start : UTC of the first pulse, from which times count, datetime64[ns]
    calibrated : whether amplitudes are roots of radar cross sections
    """

    name: str
    mode: str
    bistatic: bool
    channels: tuple[str, ...]
    vectors: NDArray[np.void]
    n_samples: int
    area: GroundArea
    anchor: Anchor
    dwell: tuple[float, float, float]
    facts: dict[str, str]
    start: np.datetime64
    calibrated: bool


def document(recording: CphdRecording) -> lxml.etree._ElementTree:
    """CPHD XML tree of a recording."""
    import lxml.etree
    import sarkit.cphd

    root = lxml.etree.Element(f"{{{NAMESPACE}}}CPHD", nsmap={None: NAMESPACE})
    tree = lxml.etree.ElementTree(root)
    top: Element = sarkit.cphd.ElementWrapper(root)
    vectors, area = recording.vectors, recording.area
    top["CollectionID"] = {
        "CollectorName": "sarmitsuba",
        "CoreName": recording.name,
        "CollectType": "BISTATIC" if recording.bistatic else "MONOSTATIC",
        "RadarMode": {"ModeType": MODE_TYPES.get(recording.mode, OTHER_MODE)},
        "Classification": "UNCLASSIFIED",
        "ReleaseInfo": "UNRESTRICTED",
    }
    top["Global"] = {
        "DomainType": "FX",
        "SGN": -1,
        "Timeline": {
            "CollectionStart": whole_microseconds(recording.start),
            "TxTime1": float(vectors["TxTime"][0]),
            "TxTime2": float(vectors["TxTime"][-1]),
        },
        "FxBand": {"FxMin": float(vectors["FX1"].min()), "FxMax": float(vectors["FX2"].max())},
        "TOASwath": {"TOAMin": float(vectors["TOA1"].min()), "TOAMax": float(vectors["TOA2"].max())},
    }
    set_utc(root, "Global/Timeline/CollectionStart", recording.start)
    _scene_coordinates(top, area, recording.anchor)
    _data(top, recording)
    _channels(top, recording)
    offset = 0
    for name, size in LAYOUT:
        kind = "I8" if name == "SIGNAL" else "F8"
        top["PVP"][name] = {
            "Offset": offset,
            "Size": size,
            "dtype": np.dtype(("f8", (3,))) if size == 3 else np.dtype(kind.lower()),
        }
        offset += size
    center, slope, length = recording.dwell
    top["Dwell"] = {
        "NumCODTimes": 1,
        "CODTime": [{"Identifier": "middle", "CODTimePoly": np.array([[center], [slope]])}],
        "NumDwellTimes": 1,
        "DwellTime": [{"Identifier": "length", "DwellTimePoly": np.array([[length]])}],
    }
    root.append(sarkit.cphd.compute_reference_geometry(tree, vectors))
    top["ProductInfo"] = {
        "Profile": PROFILE if recording.calibrated else f"{PROFILE}, uncalibrated",
        "CreationInfo": [
            {
                "Application": f"sarmitsuba {__version__}",
                "DateTime": datetime.datetime.now(datetime.timezone.utc),
            }
        ],
        "Parameter": list(recording.facts.items()),
    }
    return tree


def _scene_coordinates(top: Element, area: GroundArea, anchor: Anchor) -> None:
    corners = np.array(
        [[area.low[0], area.low[1]], [area.low[0], area.high[1]], area.high, [area.high[0], area.low[1]]]
    )
    # clockwise seen from above
    ground = area.origin + corners @ area.axes
    latitude, longitude, _ = anchor.to_geodetic(ground).T
    cells = np.round((area.high - area.low) / area.spacing).astype(int)
    origin = area.origin[None]
    lat, lon, height = anchor.to_geodetic(origin)[0]
    top["SceneCoordinates"] = {
        "EarthModel": "WGS_84",
        "IARP": {
            "ECF": anchor.to_ecef(origin)[0],
            "LLH": np.array([np.degrees(lat), np.degrees(lon), height]),
        },
        "ReferenceSurface": {
            "Planar": {"uIAX": area.axes[0] @ anchor.axes, "uIAY": area.axes[1] @ anchor.axes}
        },
        "ImageArea": {"X1Y1": area.low, "X2Y2": area.high, "Polygon": corners},
        "ImageAreaCornerPoints": np.degrees(np.stack([latitude, longitude], axis=1)),
        "ImageGrid": {
            "IARPLocation": -area.low / area.spacing - 0.5,  # pixel 0 is centred half a spacing inside
            "IAXExtent": {"LineSpacing": float(area.spacing[0]), "FirstLine": 0, "NumLines": int(cells[0])},
            "IAYExtent": {
                "SampleSpacing": float(area.spacing[1]),
                "FirstSample": 0,
                "NumSamples": int(cells[1]),
            },
        },
    }


def _data(top: Element, recording: CphdRecording) -> None:
    n_pulses = recording.vectors.size
    top["Data"] = {
        "SignalArrayFormat": "CF8",
        "NumBytesPVP": VECTOR_BYTES,
        "NumCPHDChannels": len(recording.channels),
        "Channel": [
            {
                "Identifier": channel,
                "NumVectors": n_pulses,
                "NumSamples": recording.n_samples,
                "SignalArrayByteOffset": 8 * i * n_pulses * recording.n_samples,
                "PVPArrayByteOffset": i * n_pulses * VECTOR_BYTES,
            }
            for i, channel in enumerate(recording.channels)
        ],
        "NumSupportArrays": 0,
    }


def _channels(top: Element, recording: CphdRecording) -> None:
    vectors = recording.vectors
    steady = {
        name: bool(np.ptp(vectors[first]) == 0.0 and np.ptp(vectors[last]) == 0.0)
        for name, first, last in (("FX", "FX1", "FX2"), ("TOA", "TOA1", "TOA2"))
    }
    low, high = float(vectors["FX1"].min()), float(vectors["FX2"].max())
    top["Channel"] = {
        "RefChId": recording.channels[0],
        "FXFixedCPHD": steady["FX"],
        "TOAFixedCPHD": steady["TOA"],
        "SRPFixedCPHD": True,
        "Parameters": [
            {
                "Identifier": channel,
                "RefVectorIndex": vectors.size // 2,
                "FXFixed": steady["FX"],
                "TOAFixed": steady["TOA"],
                "SRPFixed": True,
                "SignalNormal": True,
                "Polarization": dict(
                    zip(("TxPol", "RcvPol"), polarisations(channel, recording.name), strict=True)
                ),
                "FxC": 0.5 * (low + high),
                "FxBW": high - low,
                "TOASaved": float(vectors["TOA2"].max() - vectors["TOA1"].min()),
                "DwellTimes": {"CODId": "middle", "DwellId": "length"},
                "ImageArea": {"X1Y1": recording.area.low, "X2Y2": recording.area.high},
            }
            for channel in recording.channels
        ],
    }
