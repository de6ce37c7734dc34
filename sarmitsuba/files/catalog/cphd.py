r"""CPHD 1.1, the NGA standard for compensated phase history data: writing and reading of raw data; see docs/files.md.

A file holds one vector of frequency samples per channel and pulse, referred to the scene reference point,

.. math:: F_{kn} = \sum_p a_p e^{-j 2 \pi f_k (\tau_{pn} - \tau_n)}

with the two-way delays of the scatterer and of the reference point, and per vector the Earth-fixed antenna position.
The echoes are calibrated: the amplitude a_p of a point is the square root of its radar cross section, m.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import printable
from sarmitsuba.files.cphd_document import LAYOUT, PROFILE, CphdRecording, GroundArea, document
from sarmitsuba.files.formats import FORMATS, FileFormat
from sarmitsuba.files.labelled import formats_package
from sarmitsuba.files.nga import LETTERS, plain_xml, read_apart, read_utc, refuse_document_type
from sarmitsuba.files.phase_history import PhaseHistory, raw_of
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.radar.collection import Signal
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.mode import MODES, AimGeometry
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.utc import utc_after
from sarmitsuba.signal.raw_data import RawData

if TYPE_CHECKING:
    import lxml.etree


# length of the transformed profile over the receive window: the standard requires 1.1 times the stated valid part, and
# profiles contain side lobes of points at the edge
_PADDING = 1.2
# largest distance, m, between transmission and reception for which both are by the same antenna
_SAME_ANTENNA = 1e-3
# share of the total time above which one aperture is used for all pixels
_WHOLE = 0.98


def write_raw(path: Path, raw: RawData) -> None:
    """Write the channels of a recording, each the sum of its layers.

    Raises
    ------
    DataError
        The data are not range compressed, or sarkit is missing.
    """
    sarkit = formats_package("sarkit.cphd", f"{path}: CPHD files need")
    if raw.domain != "compressed":
        raise DataError(
            f"{path}: CPHD needs range-compressed data, these are {raw.domain}; range compress them first"
        )
    radar = raw.radar.in_file_frame()
    # antennas that move within the pulse shift echoes: the shift of the boresight is removed from the ranges
    radar = replace(radar, window=radar.start_stop().window)
    vectors = _vectors(radar)
    frequency = _frequencies(radar)
    vectors["SC0"], vectors["SCSS"] = frequency[0], frequency[1] - frequency[0]
    mode = radar.mode
    recording = CphdRecording(
        name=printable(str(raw.metadata.get("scene", path.stem))),
        mode=mode,
        bistatic=radar.receiver is not None and not radar.receives_itself,
        channels=raw.channels,
        vectors=vectors,
        n_samples=frequency.size,
        area=_area(radar, raw.request and raw.request.in_frame()),
        anchor=radar.anchor,
        dwell=_dwell(radar),
        facts={"pulse_width_s": repr(radar.waveform.pulse_width), "antenna_pattern": radar.antenna.pattern},
        start=utc_after(radar.track.epoch, float(radar.track.time[0])),
        calibrated=raw.calibrated,
    )
    tree = document(recording)
    metadata = sarkit.Metadata(xmltree=tree)
    with (
        atomic_path(path) as temporary,
        temporary.open("wb") as file,
        sarkit.Writer(file, metadata) as writer,
    ):
        for channel in raw.channels:
            writer.write_signal(channel, _history(raw.total(channel), radar, frequency))
            writer.write_pvp(channel, vectors)


def _slant_vectors(radar: Radar) -> tuple[F64, F64]:
    """Distances of the aim point from transmitter and receiver, m."""
    there = np.linalg.norm(radar.track.position - radar.aim_point, axis=1)
    if radar.receiver is None:
        return there, there
    return there, np.linalg.norm(radar.receiver.position - radar.aim_point, axis=1)


def _vectors(radar: Radar) -> NDArray[np.void]:
    """Per-vector parameters, Earth-fixed; the sampling of the frequencies is filled in by the caller."""
    anchor, track = radar.anchor, radar.track
    receiver = radar.receiver or track
    kinds = [
        (name, ">i8" if name == "SIGNAL" else ">f8", (size,) if size > 1 else ()) for name, size in LAYOUT
    ]
    vectors = np.zeros(track.n_pulses, dtype=np.dtype(kinds))
    there, back = _slant_vectors(radar)
    vectors["TxTime"] = track.time - track.time[0]
    vectors["RcvTime"] = vectors["TxTime"] + (there + back) / SPEED_OF_LIGHT
    for name, one in (("Tx", track), ("Rcv", receiver)):
        vectors[f"{name}Pos"] = anchor.to_ecef(one.position)
        vectors[f"{name}Vel"] = one.velocity @ anchor.axes
    vectors["SRPPos"] = anchor.to_ecef(radar.aim_point[None])[0]
    rate = np.zeros(track.n_pulses)
    for one in (track, receiver):
        line = one.position - radar.aim_point
        rate += 0.5 * np.einsum("ij,ij->i", one.velocity, line) / np.linalg.norm(line, axis=1)
    vectors["aFDOP"] = -2.0 / SPEED_OF_LIGHT * rate
    fc, bandwidth = radar.waveform.center_frequency, radar.waveform.bandwidth
    vectors["FX1"], vectors["FX2"] = fc - 0.5 * bandwidth, fc + 0.5 * bandwidth
    start = radar.window.start_range - 0.5 * (there + back)
    vectors["TOA1"] = 2.0 / SPEED_OF_LIGHT * start.max()  # common to all vectors
    vectors["TOA2"] = 2.0 / SPEED_OF_LIGHT * (start.min() + radar.window.extent)
    vectors["SIGNAL"] = 1
    return vectors


def _frequencies(radar: Radar) -> F64:
    """Frequencies of the samples, Hz: those of the padded profile's transform that lie in the band."""
    window, wave = radar.window, radar.waveform
    n = _pad_radar(radar)
    step = SPEED_OF_LIGHT / (2.0 * n * window.sample_spacing)
    half = int(np.floor(0.5 * wave.bandwidth / step))
    return np.asarray(wave.center_frequency + step * np.arange(-half, half + 1))


def _pad_radar(radar: Radar) -> int:
    return int(scipy.fft.next_fast_len(int(np.ceil(_PADDING * radar.window.n_samples))))


def _history(profiles: C64, radar: Radar, frequency: F64) -> C64:
    """Frequency samples (n_pulses, n_frequencies) of range profiles, referred to the aim point."""
    there, back = _slant_vectors(radar)
    reference = 0.5 * (there + back)
    window, fc = radar.window, radar.waveform.center_frequency
    n, half = _pad_radar(radar), frequency.size // 2
    level = there * back / radar.amplitude_constant * window.sample_spacing / radar.waveform.range_cell
    wave = 4.0 * np.pi / SPEED_OF_LIGHT
    out = np.empty((profiles.shape[0], frequency.size), dtype=np.complex64)
    rows = max(1, 2**22 // n)
    for first in range(0, profiles.shape[0], rows):
        pick = slice(first, first + rows)
        spectrum = scipy.fft.fft(profiles[pick].astype(np.complex128), n=n, axis=1, workers=-1)
        band = np.concatenate([spectrum[:, n - half :], spectrum[:, : half + 1]], axis=1)
        start = window.start_range[pick] - reference[pick]
        band *= np.exp(-1j * wave * np.outer(start, frequency - fc))
        band *= (level[pick] * np.exp(1j * wave * fc * reference[pick]))[:, None]
        out[pick] = band
    return out


def _area(radar: Radar, request: ImageRequest | None) -> GroundArea:
    """Area of the requested image; without one the swath around the aim point within the window."""
    along = radar.track.along
    axes = np.array([along, [-along[1], along[0], 0.0]])
    if request is None:
        half = np.full(2, 0.35 * radar.window.extent)
        middle = np.zeros(2)
    else:
        half = 0.5 * np.array([request.extent_azimuth, request.extent_range])
        middle = axes @ (np.array([request.center_x, request.center_y, radar.aim_point[2]]) - radar.aim_point)
    cell = radar.waveform.range_cell
    return GroundArea(radar.aim_point, axes, middle - half, middle + half, np.full(2, 0.8 * cell))


def _dwell(radar: Radar) -> tuple[float, float, float]:
    """Centre time of the aim point's aperture (s, at the ground), its slope along the flight, and the dwell time."""
    signal = Signal.of(radar)
    whole = float(radar.track.time[-1] - radar.track.time[0])
    there = _slant_vectors(radar)[0]
    first, last = there[0] / SPEED_OF_LIGHT, whole + there[-1] / SPEED_OF_LIGHT
    if signal.aperture >= whole * (1.0 - 1e-9):
        return 0.5 * (first + last), 0.0, last - first
    speed = float(np.linalg.norm(radar.track.velocity[radar.track.center_index]))
    return 0.5 * (first + last), 1.0 / (speed * radar.footprint_speed), signal.aperture


def read_raw(path: Path) -> RawData:
    """Read a recording, in the frame of its scene reference point (east, north, up).

    Raises
    ------
    DataError
        The file is damaged or of another format, its samples are over time instead of frequency, or sarkit is missing.

    Notes
    -----
    Monostatic data are focused from the midpoint between the positions at transmission and reception; the two-way range
    differs from the true one by the square of half their distance over the range (0.5 mm from orbit), equal for all
    points to within thousandths. Vectors marked as without signal are omitted. Tropospheric delay is not applied.
    Antenna patterns are not read.
    """
    sarkit = formats_package("sarkit.cphd", f"{path}: CPHD files need")
    return read_apart(path, "CPHD", lambda: _read(path, sarkit))


def _read(path: Path, sarkit: ModuleType) -> RawData:
    """Recording of a file."""
    with path.open("rb") as file, plain_xml():
        _check_header(path, sarkit.read_file_header(file)[1])
        file.seek(0)
        reader = sarkit.Reader(file)
        tree = reader.metadata.xmltree
        refuse_document_type(tree, str(path))
        _check_size(path, tree, sarkit.get_pvp_dtype(tree).itemsize)
        helper = sarkit.XmlHelper(tree)
        if helper.load("{*}Global/{*}DomainType") != "FX":
            raise DataError(
                f"{path}: samples over time of arrival (TOA) are not supported; write them over frequency (FX)"
            )
        sign = helper.load("{*}Global/{*}SGN")
        latitude, longitude, height = helper.load("{*}SceneCoordinates/{*}IARP/{*}LLH")
        anchor = Anchor(np.radians(latitude), np.radians(longitude), height)
        corners = helper.load("{*}SceneCoordinates/{*}ImageAreaCornerPoints")
        center, length = (
            helper.load(f"{{*}}Dwell/{{*}}{name}Poly")
            for name in ("CODTime/{*}CODTime", "DwellTime/{*}DwellTime")
        )
        start = read_utc(tree.getroot(), "Global/Timeline/CollectionStart")
        two = tree.findtext("{*}CollectionID/{*}CollectType") == "BISTATIC"
        histories = []
        for node in tree.findall("{*}Channel/{*}Parameters"):
            name = node.findtext("{*}Identifier")
            signal, vectors = reader.read_channel(name)
            letters = [node.findtext(f"{{*}}Polarization/{{*}}{one}Pol") for one in ("Tx", "Rcv")]
            if any(one not in LETTERS for one in letters):
                raise DataError(f"{path}: polarisation {letters} is not supported; supported: H, V, RHC, LHC")
            channel = "".join(LETTERS[one] for one in letters)
            histories.append(_read_channel(path, channel, signal, vectors, sign, anchor, two, start))
    missing = [
        name
        for name, value in (
            ("Channel/Parameters", histories),
            ("ImageAreaCornerPoints", corners),
            ("CODTimePoly", center),
            ("DwellTimePoly", length),
        )
        if value is None or not len(value)
    ]
    if missing:
        raise DataError(f"{path}: its document has no {missing[0]}; export it again")
    raw = raw_of(histories)
    radar = replace(_lit_in_turn(raw.radar, center, length), anchor=anchor)
    facts = dict(raw.metadata)
    if tree.findtext("{*}ProductInfo/{*}Profile") == PROFILE:  # amplitudes are roots of radar cross sections
        del facts["calibrated"]
    return replace(raw, radar=radar, request=_request(raw, anchor, corners), metadata=facts)


def _check_header(path: Path, header: Mapping[str, str]) -> None:
    """Raise a DataError where a block stated in the header exceeds the file."""
    size = path.stat().st_size
    for block in ("XML", "PVP", "SIGNAL"):
        first, length = (int(header[f"{block}_BLOCK_{what}"]) for what in ("BYTE_OFFSET", "SIZE"))
        if not (0 <= first and 0 < length <= size - first):
            raise DataError(
                f"{path}: the {block} block of {length} bytes from {first} is not within the {size} bytes of the file; "
                "it was cut off or is damaged"
            )


def _check_size(path: Path, tree: "lxml.etree._ElementTree", vector_bytes: int) -> None:
    """Raise a DataError where the document's sizes, with ``vector_bytes`` per vector, do not match the file."""
    promised = 0
    for node in tree.findall("{*}Data/{*}Channel"):
        vectors, samples = (int(node.findtext(f"{{*}}Num{what}")) for what in ("Vectors", "Samples"))
        if vectors <= 0 or samples <= 0:
            raise DataError(f"{path}: a channel of {vectors} vectors with {samples} samples is empty")
        promised += vectors * (2 * samples + vector_bytes)  # two bytes a sample at least
    if not 0 < promised <= path.stat().st_size:
        raise DataError(
            f"{path}: the file is too short for the {promised} bytes of its channels; it was cut off or is damaged"
        )


def _lit_in_turn(radar: Radar, center: F64, length: F64) -> Radar:
    """Stripmap radar of a file whose dwell times are short and whose aperture centres move with the flight.

    Parameters
    ----------
    radar : spotlight on the reference point
    center, length : polynomials of the centre (s) and length (s) of a point's aperture over the image's axes
    """
    track = radar.track
    whole = float(track.time[-1] - track.time[0])
    if length[0, 0] > _WHOLE * whole or not np.any(np.abs(center.ravel()[1:])):
        return radar
    speed = float(np.linalg.norm(track.velocity[track.center_index]))
    line = radar.aim_point - track.center_position
    geometry = AimGeometry(radar.aim_point, track.center_position, track.along, radar.across)
    half = 0.5 * float(length[0, 0]) * speed / float(np.linalg.norm(line)) * geometry.cos_squint**3
    pointing = MODES["stripmap"].pointing(track, geometry)
    return replace(radar, mode="stripmap", pointing=pointing, half_aperture=half)


def _request(raw: RawData, anchor: Anchor, corners: F64 | None) -> ImageRequest | None:
    """Image request of the ground within the file's corner points (degrees) and the swath."""
    assert raw.request is not None
    if corners is None:
        return raw.request
    radar = raw.radar
    height = np.full((len(corners), 1), anchor.height + radar.aim_point[2])
    points = anchor.from_geodetic(np.hstack([np.radians(corners), height])) - radar.aim_point
    local = np.stack([points @ radar.track.along, points @ radar.across], axis=1)
    low, high = local.min(axis=0), local.max(axis=0)
    middle = radar.aim_point + 0.5 * (low + high) @ np.stack([radar.track.along, radar.across])
    size = np.minimum(high - low, raw.request.extent_range)
    return replace(
        raw.request,
        center_x=float(middle[0]),
        center_y=float(middle[1]),
        extent_azimuth=float(size[0]),
        extent_range=float(size[1]),
    )


def _read_channel(
    path: Path,
    channel: str,
    signal: NDArray[np.generic],
    vectors: NDArray[np.void],
    sign: int,
    anchor: Anchor,
    two: bool,
    start: np.datetime64,
) -> PhaseHistory:
    """Phase history of one channel in the anchor's frame."""
    names = vectors.dtype.names or ()
    good = vectors["SIGNAL"] == 1 if "SIGNAL" in names else np.ones(vectors.size, dtype=bool)
    if not good.any():
        raise DataError(f"{path}: channel {channel} marks every vector as without signal")
    vectors, samples = vectors[good], _complex(signal[good])
    if "AmpSF" in names:
        samples = samples * vectors["AmpSF"].astype(np.float32)[:, None]
    there, back = (anchor.from_ecef(vectors[name].astype(np.float64)) for name in ("TxPos", "RcvPos"))
    reference = anchor.from_ecef(vectors["SRPPos"].astype(np.float64))
    legs = [np.linalg.norm(one - reference, axis=1) for one in (there, back)]
    moved = np.linalg.norm(back - there, axis=1).max() > _SAME_ANTENNA
    frequency: F64 = vectors["SC0"][None] + vectors["SCSS"][None] * np.arange(samples.shape[1])[:, None]
    steady = np.ptp(vectors["SC0"]) == 0.0 and np.ptp(vectors["SCSS"]) == 0.0
    time = vectors["TxTime"] if two or not moved else 0.5 * (vectors["TxTime"] + vectors["RcvTime"])
    return PhaseHistory(
        samples=(samples if sign < 0 else samples.conj()).T,
        frequency=frequency[:, 0] if steady else frequency,
        position=there if two or not moved else 0.5 * (there + back),
        reference_range=0.5 * (legs[0] + legs[1]),
        channel=channel,
        source=path.name,
        receiver=back if two else None,
        time=time.astype(np.float64),
        epoch=start,
    )


def _complex(signal: NDArray[Any]) -> C64:
    """Samples in any format of the standard as complex64."""
    if signal.dtype.names:
        return np.asarray(signal["real"].astype(np.float32) + 1j * signal["imag"].astype(np.float32))
    return signal.astype(np.complex64)


FORMATS.register(
    FileFormat(
        name="cphd",
        doc="CPHD 1.1: phase histories, to and from other processors (extra: formats)",
        suffixes=(".cphd",),
        write_raw=write_raw,
        read_raw=read_raw,
    )
)
