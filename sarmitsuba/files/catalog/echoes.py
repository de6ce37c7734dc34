"""Chirped echoes from elsewhere: a complex matrix in a MATLAB or NumPy file, and a header; see docs/files.md."""

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, all_finite
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import one_line, printable
from sarmitsuba.files.echo_header import EchoHeader, read_header
from sarmitsuba.files.formats import FORMATS, FileFormat
from sarmitsuba.files.phase_history import load_mat
from sarmitsuba.machine.isolated import survive
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.mode import MODES, AimGeometry
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.receiver import later
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.utc import utc_after
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.signal.doppler_estimate import estimate_doppler
from sarmitsuba.signal.image import UNCALIBRATED
from sarmitsuba.signal.raw_data import DATA_FILE, Layer, RawData

# samples at either end of the swath that the image leaves out: pixels are interpolated from their neighbours
_RIM = 4


def read_raw(path: Path) -> RawData:
    r"""Read chirped echoes by their header.

    The track is straight and level, flown at the effective velocity V, so that ranges obey
    :math:`R^2 = R_0^2 + V^2 (t - t_0)^2`; the beam is at the squint of the Doppler centroid,
    :math:`\sin \psi = \lambda f_{DC} / 2 V`, in stripmap. The antenna moves between transmission and reception.

    Raises
    ------
    DataError
        The header or the data are damaged, contradict each other, or the Doppler centroid cannot be estimated.

    Notes
    -----
    One effective velocity and one squint angle serve the whole swath: ignores their change over range (and with it
    that of the centroid). The antenna's pattern is unknown and taken as isotropic over the processed Doppler band.
    The data are uncalibrated: a point in the middle of the swath has the amplitude of its samples. The frame's origin
    is below mid-track; its place on the Earth is not known.
    """
    header = read_header(path)
    echoes = _echoes(path.parent / header.data, header)
    n_pulses, n_fast = echoes.shape
    pulse = math.ceil(header.pulse_length * header.sampling_rate)
    if n_fast <= pulse + 1 or n_pulses < 16:
        raise DataError(
            f"{path}: {header.data} holds {n_pulses} pulses of {n_fast} samples along pulses_along = "
            f"{header.pulses_along}; at least 16 pulses are needed, longer than the {pulse} samples of the chirp"
        )
    facts: dict[str, object] = {"source": path.name, DATA_FILE: header.data, **UNCALIBRATED}
    centroid = header.doppler_centroid
    if centroid is None:
        try:
            found = estimate_doppler(
                echoes, header.prf, header.carrier, header.sampling_rate, header.bandwidth
            )
        except DataError as error:
            raise DataError(f"{path}: {error}") from None
        centroid = found.frequency
        header.check_centroid(centroid)
        facts["doppler_centroid"] = {
            "frequency_hz": found.frequency,
            "deviation_hz": found.deviation,
            "multiple_of_prf": found.multiple,
            "from_range_walk_hz": found.walk,
            "from_range_walk_deviation_hz": found.walk_deviation,
        }
    radar, request = _radar(path, header, centroid, n_pulses, n_fast - pulse)
    # a point at the middle range keeps the amplitude of its samples
    middle = float(radar.window.start_range[0]) + 0.5 * radar.window.extent
    echoes *= np.float32(radar.amplitude_constant / middle**2)
    return RawData(echoes[None], (Layer(header.channel),), "chirped", radar, facts, request)


def _echoes(path: Path, header: EchoHeader) -> C64:
    """(n_pulses, n_fast) complex64 samples of the data file."""
    if not os.path.isfile(path):
        raise DataError(f"{path}: no such file, which {header.source} names")
    matrix = _from_numpy(path, header) if path.suffix.lower() == ".npy" else _from_matlab(path, header)
    if matrix.ndim != 2 or matrix.dtype.kind != "c":
        raise DataError(f"{path}: holds {matrix.dtype} of shape {matrix.shape}; a complex matrix is needed")
    matrix = matrix if header.pulses_along == "rows" else matrix.T
    with np.errstate(over="ignore"):
        echoes = np.array(matrix, dtype=np.complex64, order="C")
    if not all_finite(echoes):
        raise DataError(f"{path}: holds NaN or infinite samples; set missing samples to zero")
    return echoes


def _from_numpy(path: Path, header: EchoHeader) -> NDArray[np.generic]:
    if header.variable:
        raise DataError(
            f'{header.source}: variable = "{printable(header.variable)[:60]}" has no effect with a .npy file'
        )
    try:  # mapped: a header that claims more than the file holds takes no memory
        return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    except (OSError, ValueError, EOFError, OverflowError, MemoryError, SyntaxError) as error:
        raise DataError(f"{path}: cannot be read as a NumPy array: {one_line(error, 200)}") from None


def _from_matlab(path: Path, header: EchoHeader) -> NDArray[np.generic]:
    names = [header.variable] if header.variable else None
    try:
        survive(path, lambda: load_mat(path, names))
    except DataError as error:
        raise DataError(f"{path}: cannot be read as a MATLAB file: {error}") from None
    found = {name: value for name, value in load_mat(path, names).items() if not name.startswith("__")}
    matrices = {name: np.asarray(value) for name, value in found.items() if np.iscomplexobj(value)}
    if header.variable and header.variable not in matrices:
        raise DataError(f'{path}: has no complex matrix "{printable(header.variable)[:60]}"')
    if len(matrices) != 1:
        raise DataError(
            f"{path}: has {len(matrices)} complex matrices{': ' if matrices else ''}"
            f"{printable(', '.join(sorted(matrices)))[:200]}; name one by variable in {header.source}"
        )
    return next(iter(matrices.values()))


def _radar(
    path: Path, header: EchoHeader, centroid: float, n_pulses: int, n_samples: int
) -> tuple[Radar, ImageRequest]:
    """Radar of the effective track, and the image of all that whole apertures show."""
    squint, half = header.sine(centroid), 0.5 * header.sine(header.doppler_bandwidth)
    edges = np.array([squint - half, squint + half])
    cosines = np.sqrt(1.0 - edges**2)
    spacing = SPEED_OF_LIGHT / (2.0 * header.sampling_rate)
    first = 0.5 * SPEED_OF_LIGHT * header.first_sample_time
    last = first + (n_samples - 1) * spacing
    # ranges of closest approach whose whole migration was recorded, less the shift of a chirp by the centroid
    rim = _RIM * spacing + abs(0.5 * SPEED_OF_LIGHT * centroid / header.chirp_rate)
    near = (first + rim) * (1.0 if edges[0] <= 0.0 <= edges[1] else float(cosines.max()))
    far = (last - rim) * float(cosines.min())
    if not near < far:
        raise DataError(
            f"{path}: the range migration over doppler_bandwidth_hz = {header.doppler_bandwidth:g} about the centroid "
            f"{centroid:g} Hz is longer than the swath of {first:.7g} to {last:.7g} m; no range is recorded throughout"
        )
    middle = 0.5 * (near + far)
    height = middle * math.cos(header.incidence_angle)
    if height >= near:
        raise DataError(
            f"{path}: at incidence_angle_deg = {math.degrees(header.incidence_angle):g} of the middle range "
            f"{middle:.6g} m the nearest range {near:.6g} m is above the ground; give a larger angle"
        )
    flight = np.array([0.0, header.effective_velocity, 0.0])
    track = Track.straight([0.0, 0.0, height], flight, header.prf, n_pulses)
    if header.first_pulse is not None:
        track = replace(track, epoch=utc_after(header.first_pulse, -float(track.time[0])))
    across = np.array([1.0 if header.look_side == "right" else -1.0, 0.0, 0.0])
    along = np.array([0.0, 1.0, 0.0])
    ground = [math.sqrt(one**2 - height**2) for one in (near, far)]
    tangent = squint / math.sqrt(1.0 - squint**2)
    aim = 0.5 * (ground[0] + ground[1]) * across
    aim_range = float(np.hypot(aim[0], height))
    aim = aim + aim_range * tangent * along
    center = np.array([0.0, 0.0, height])
    sweep = "up" if header.chirp_rate > 0.0 else "down"
    delay = np.full(n_pulses, 2.0 * float(np.linalg.norm(aim - center)) / SPEED_OF_LIGHT)
    radar = Radar(
        mode="stripmap",
        track=track,
        waveform=Waveform(
            header.carrier, header.bandwidth, header.pulse_length, "up" if sweep == "up" else "down"
        ),
        antenna=Antenna(),
        pointing=MODES["stripmap"].pointing(track, AimGeometry(aim, center, along, across)),
        # the first sample is the beginning of an echo from this range
        window=ReceiveWindow(np.full(n_pulses, first), spacing, n_samples),
        channels=(header.channel,),
        look_side="right" if header.look_side == "right" else "left",
        aim_point=aim,
        half_aperture=half,
    )
    radar = replace(radar, receiver=later(track, delay), delay=delay)
    # places whose whole apertures were flown, at all ranges
    tangents = edges / cosines
    span = float(track.time[-1] - track.time[0]) * header.effective_velocity
    starts = [one * t for one in (near, far) for t in tangents]
    low, high = -0.5 * span + max(starts), 0.5 * span + min(starts)
    if high - low < 0.1 * span:  # recorded for less than an aperture
        center_y, size = middle * tangent, 0.5 * span
    else:
        center_y, size = 0.5 * (low + high), high - low
    request = ImageRequest(
        grid="slant",
        center_x=float(0.5 * (ground[0] + ground[1]) * across[0]),
        center_y=float(center_y),
        height=0.0,
        extent_azimuth=float(size),
        extent_range=float(ground[1] - ground[0]),
    )
    return radar, request


FORMATS.register(
    FileFormat(
        "echoes",
        "external chirped echoes: a header that names a MATLAB or NumPy file; read only",
        (".json", ".toml"),
        read_raw=read_raw,
    )
)
