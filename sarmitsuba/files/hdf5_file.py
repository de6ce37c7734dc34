"""HDF5 files of this program: head, guarded writing, reading of untrusted files, dataclasses, and grids of images.

A dataclass is a group: numbers are datasets with the attributes ``unit`` and ``description``, texts are attributes.
"""

import dataclasses
import math
import os
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import h5py
import numpy as np
from h5py._objects import phil as h5py_lock

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.machine.exclusive import backend_lock
from sarmitsuba.machine.guarded import GuardedFile
from sarmitsuba.machine.isolated import survive
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.utc import utc_of, utc_text
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.version import __version__

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


D = TypeVar("D", bound="DataclassInstance")

# unit and meaning of every number, by field name, or by class and field for names with several meanings
FACTS: Mapping[str, tuple[str, str]] = {
    "Emitters.bandwidth": ("Hz", "of a narrow band or of a chirp"),
    "Emitters.position": ("m", "of the emitters"),
    "Emitters.pulse_width": ("s", "of chirps and pulses"),
    "Anchor.height": ("m", "of the origin of the frame, over the WGS-84 ellipsoid"),
    "adc_bits": ("1", "of the converter, for I and for Q; 0: none"),
    "across": ("1", "horizontal unit vector across the track, towards the side looked to"),
    "aim_point": ("m", "reference point of the geometry"),
    "along": ("1", "horizontal unit vector of flight"),
    "azimuth": ("m", "of the rows: metres along `along` from `origin`"),
    "azimuth_axis": ("1", "unit vector along the aperture, per pulse"),
    "azimuth_cut": ("rad, 1", "angle off boresight and one-way power gain over its peak"),
    "azimuth_beamwidth": ("rad", "one-way half-power width"),
    "azimuth_resolution_cell": ("m", "noise-equivalent width of the impulse response, image centre"),
    "baq_bits": ("1", "of block-adaptive quantisation, for I and for Q"),
    "baq_block": ("1", "samples of a pulse that share a scale"),
    "bandwidth": ("Hz", "swept by the pulse"),
    "beam": ("1", "unit vectors of the middle of the emitters' beams"),
    "beamwidth": ("rad", "half power, of the emitters"),
    "boresight": ("1", "unit vector of the beam, per pulse"),
    "cell_area": ("m^2", "ground area of a resolution cell: sigma0 = |pixel|^2 / cell_area"),
    "center_frequency": ("Hz", "carrier"),
    "center_x": ("m", "image centre, east"),
    "center_y": ("m", "image centre, north"),
    "cycle": ("s", "from a burst to the next of the same sub-swath"),
    "dead_pulses": ("1", "share of pulses that were lost"),
    "delay": ("s", "delay from transmission to reception, per pulse, where the antenna moves on meanwhile"),
    "eirp": ("W", "peak power of an emitter times the gain at the middle of its beam"),
    "elevation_axis": ("1", "unit vector across the aperture, per pulse"),
    "elevation_cut": ("rad, 1", "angle off boresight and one-way power gain over its peak"),
    "elevation_beamwidth": ("rad", "one-way half-power width"),
    "extent_azimuth": ("m", "image size along the track, on the ground"),
    "extent_range": ("m", "image size across the track, on the ground"),
    "frequency": ("Hz", "middle of the emitters' bands"),
    "kind": ("1", "of emitters: 0 narrow-band, 1 chirps, 2 pulses"),
    "repetition": ("Hz", "pulse repetition frequency of the emitters"),
    "fdbaq_margin_db": ("dB", "least ratio of thermal to quantisation noise"),
    "gain_drift_db": ("dB", "change of the receiver's gain from the first to the last pulse"),
    "gain_jitter_db": ("dB", "random change of the receiver's gain between pulses, rms"),
    "iq_gain_db": ("dB", "gain of Q over that of I"),
    "iq_offset_i": ("1", "constant added to I, over the rms of I"),
    "iq_offset_q": ("1", "constant added to Q, over the rms of Q"),
    "iq_phase_deg": ("deg", "angle between Q and I less 90 degrees"),
    "saturation_db": ("dB", "level at which I and Q are clipped, over their rms; inf: none"),
    "transmit_gaps": ("1", "1: the receiver was off while a pulse was transmitted"),
    "gain": ("1", "peak one-way power gain of the antenna"),
    "half_aperture": ("1", "half the synthetic aperture of a pixel, in sines; inf: all pulses serve every pixel"),
    "height": ("m", "height of the horizontal image plane"),
    "incidence_angle": ("rad", "at mid-aperture on the image plane, per column"),
    "latitude": ("rad", "WGS-84, of the origin of the frame"),
    "longitude": ("rad", "WGS-84, of the origin of the frame"),
    "losses": ("1", "two-way system losses, power"),
    "middle": ("s", "middle of the burst; 0 is when the aim point is at zero Doppler"),
    "n_samples": ("1", "samples of a range-compressed profile"),
    "noise_temperature": ("K", "of the receiver with its antenna; 0: no noise"),
    "number": ("1", "of the burst, 0 about the aim point"),
    "origin": ("m", "origin of azimuth and range"),
    "position": ("m", "of the antenna's phase centre, per pulse"),
    "phase_correction": ("rad", "of a provider's autofocus, per pulse; not applied to the echoes"),
    "pulse_width": ("s", "length of the transmitted pulse"),
    "range": ("m", "of the columns: slant range, or metres along `across` from `origin`"),
    "range_correction": ("m", "of a provider's autofocus, per pulse, added to ranges; not applied to the echoes"),
    "range_resolution_cell": ("m", "noise-equivalent width of the impulse response in slant range"),
    "sample_spacing": ("m", "slant range between samples, c / (2 sampling rate)"),
    "pixels_azimuth": ("1", "number of pixels along the track; 0: as many as cover the extent"),
    "pixels_range": ("1", "number of pixels in range; 0: as many as cover the extent"),
    "spacing_azimuth": ("m", "pixel spacing along the track; 0: half a cell"),
    "spacing_range": ("m", "pixel spacing in range; 0: half a cell"),
    "start_range": ("m", "slant range of the first sample, per pulse"),
    "steering_rate": ("rad/s", "turn of the beam during a burst, positive forward"),
    "time": ("s", "of transmission, per pulse"),
    "transmit_power": ("W", "peak"),
    "velocity": ("m/s", "of the antenna, per pulse"),
    "wavelength": ("m", "at the centre frequency"),
}  # fmt: skip
# fields of one dimension
_VECTORS = frozenset(
    {
        "across",
        "aim_point",
        "along",
        "azimuth",
        "cell_area",
        "beamwidth",
        "delay",
        "eirp",
        "frequency",
        "kind",
        "repetition",
        "incidence_angle",
        "origin",
        "phase_correction",
    }
    | {"range", "range_correction", "start_range", "time"}
)
# fields that older files do not have, with a default: counts of pixels, direction of the chirp, date
_LATER = ("pixels_azimuth", "pixels_range", "sweep", "code", "pulse_filter", "epoch")
# largest compression ratio: a dataset that states more is damaged or malicious
_MOST_COMPRESSION = 1100
_ALLOWANCE = 1 << 20  # bytes allowed for a small dataset independent of its stored size


def write_number(group: h5py.Group, name: str, value: object, owner: str = "") -> None:
    """Write a dataset with its unit and meaning; ``owner`` is the class whose field it is."""
    group[name] = value
    unit, description = FACTS.get(f"{owner}.{name}") or FACTS[name]
    group[name].attrs["unit"], group[name].attrs["description"] = unit, description


def write_fields(group: h5py.Group, content: "DataclassInstance", leave_out: tuple[str, ...] = ()) -> None:
    """Write the fields of a dataclass into a group, nested dataclasses as subgroups."""
    for field in dataclasses.fields(content):
        value = getattr(content, field.name)
        if field.name in leave_out or value is None:
            continue
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            write_fields(group.create_group(field.name), value)
        elif isinstance(value, str):
            group.attrs[field.name] = value
        elif isinstance(value, np.datetime64):
            group.attrs[field.name] = utc_text(value)
        elif isinstance(value, bool):
            write_number(group, field.name, int(value), type(content).__name__)
        elif isinstance(value, tuple):
            group.attrs[field.name] = list(value)
        else:
            write_number(group, field.name, value, type(content).__name__)


def read_fields(group: h5py.Group, cls: type[D], **known: object) -> D:
    """Read a dataclass from a group; every field must have its declared type.

    Parameters
    ----------
    group : as written by :func:`write_fields`
    cls : the dataclass
    known : fields stored elsewhere

    Raises
    ------
    DataError
        A field is missing or of another type, or the file was written by another program.
    """
    values = dict(known)
    hints = typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        if field.name in known:
            continue
        hint = hints[field.name]
        if type(None) in typing.get_args(hint):  # a dataclass, or nothing
            (hint,) = (part for part in typing.get_args(hint) if part is not type(None))
            if not has(group, field.name):
                values[field.name] = None
                continue
        if field.name in _LATER and not (has(group, field.name) or field.name in group.attrs):
            values[field.name] = field.default
        else:
            values[field.name] = _value(group, field.name, hint)
    return cls(**values)


def _value(group: h5py.Group, name: str, hint: type) -> object:
    """Field of a dataclass by its declared type."""
    if dataclasses.is_dataclass(hint):
        return read_fields(group_of(group, name), hint)
    if hint is bool:
        return bool(number(group, name, int))
    if hint is float or hint is int:
        return number(group, name, float if hint is float else int)
    if typing.get_origin(hint) is tuple:
        return texts_of(group, name)
    if hint in (str, np.datetime64) or typing.get_origin(hint) is typing.Literal:
        (text,) = texts_of(group, name)
        return utc_of(text) if hint is np.datetime64 else text
    return numbers(group, name)


def group_of(group: h5py.Group, name: str) -> h5py.Group:
    """A group in a group."""
    found = _item(group, name)
    if not isinstance(found, h5py.Group):
        raise DataError(f"{found.name} is not a group")
    return found


def dataset(group: h5py.Group, name: str) -> h5py.Dataset:
    """A dataset stored completely in the file itself.

    Raises
    ------
    DataError
        It is missing, is stored in another file, or states more data than are stored.
    """
    found = _item(group, name)
    if not isinstance(found, h5py.Dataset) or found.shape is None:
        raise DataError(f"{found.name} is not a dataset")
    if found.external or found.is_virtual:
        raise DataError(f"{found.name} refers to other files; copy the data into this one")
    claimed = math.prod(found.shape) * found.dtype.itemsize
    stored = found.id.get_storage_size()
    if claimed > _MOST_COMPRESSION * stored + _ALLOWANCE:
        raise DataError(f"{found.name} states {claimed / 1e9:.3g} GB, but {stored} bytes are stored")
    return found


def number(group: h5py.Group, name: str, kind: type[float] | type[int]) -> float | int:
    """A single real number; NaN is an error."""
    found = dataset(group, name)
    if found.shape != () or found.dtype.kind not in ("iu" if kind is int else "fiu"):
        raise DataError(f"{found.name} is not a single {'integer' if kind is int else 'number'}")
    value = kind(found[()].item())
    if math.isnan(value):
        raise DataError(f"{found.name} is not a number")
    return value


def numbers(group: h5py.Group, name: str) -> F64:
    """An array of finite real numbers, float64; a vector that is stored as a row or a column becomes one again."""
    found = dataset(group, name)
    if found.dtype.kind not in "fiu":
        raise DataError(f"{found.name} does not hold real numbers")
    value = np.asarray(found[()], dtype=np.float64)
    if name in _VECTORS:
        if sorted(value.shape)[:-1] != [1] * (value.ndim - 1) or value.ndim == 0:
            raise DataError(f"{found.name} has the shape {value.shape}, and is no vector")
        value = value.reshape(-1)  # MATLAB writes vectors as (n, 1) and (1, n)
    if not np.isfinite(value).all():
        raise DataError(f"{found.name} holds NaN or infinite numbers")
    return value


def texts_of(group: h5py.Group, name: str) -> tuple[str, ...]:
    """Text or texts of an attribute."""
    value = group.attrs.get(name)
    found = [value] if isinstance(value, str) else list(np.atleast_1d(value))
    if not all(isinstance(text, str) for text in found):
        raise DataError(f"{group.name} has no attribute {name}, or it is not a text")
    return tuple(str(text) for text in found)


def has(group: h5py.Group, name: str) -> bool:
    """Whether an entry of that name exists."""
    return group.get(name, getlink=True) is not None


def _item(group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset:
    link = group.get(name, getlink=True)
    where = f"{group.name.rstrip('/')}/{name}"
    if link is None:
        raise DataError(f"{where} is missing")
    if not isinstance(link, h5py.HardLink):
        raise DataError(f"{where} is a link; copy the data there")
    return group[name]


FORMAT_VERSION = 3
CONVENTION = "time exp(+j w t); a point at slant range R has the phase exp(-j 4 pi center_frequency R / c)"
FRAME = "the scene file's own: x east, y north, z up, metres; its origin on the Earth is in the group anchor"
_POSITION = {
    "slant": "pixel (a, r): (origin x, origin y, height) + azimuth[a] along + sqrt(range[r]^2 - h^2) across, "
    "h = origin z - height",
    "ground": "pixel (a, r): (origin x, origin y, height) + azimuth[a] along + range[r] across",
}

T = TypeVar("T")


def write_hdf5(path: Path | str, content: str, fill: Callable[[h5py.File], None]) -> None:
    """Write a file atomically."""
    with atomic_path(path) as temporary, GuardedFile(temporary) as guarded:
        try:
            with h5py.File(guarded, "w") as file:
                file.attrs["format"] = f"sarmitsuba {content}"
                file.attrs["format_version"] = FORMAT_VERSION
                file.attrs["software"] = f"sarmitsuba {__version__}"
                file.attrs["phase_convention"] = CONVENTION
                file.attrs["frame"] = FRAME
                fill(file)
        finally:
            if guarded.error is not None:
                raise guarded.error


def read_hdf5(path: Path | str, content: str, wanted: str, load: Callable[[h5py.File, bool], T]) -> T:
    """Result of ``load`` for the file with its planes, after a trial without them in a separate process."""
    path = Path(path)
    if not os.path.isfile(path):
        raise DataError(f"{path}: no such file; give the {wanted} file written by `sarmitsuba render`")

    def read(planes: bool) -> T:
        with h5py.File(path, "r") as file:
            found = file.attrs.get("format")
            if found != f"sarmitsuba {content}":
                raise DataError(f"holds {found or 'other HDF5 data'}, not {wanted} of sarmitsuba")
            version = int(file.attrs.get("format_version", 0))
            if version != FORMAT_VERSION:
                remedy = "update sarmitsuba" if version > FORMAT_VERSION else "simulate again"
                raise DataError(f"format version {version}, this program reads {FORMAT_VERSION}; {remedy}")
            return load(file, planes)

    try:
        # no other thread may hold the lock of h5py at the fork; in this order, since exclusive functions read files
        with backend_lock(), h5py_lock:
            survive(path, lambda: read(planes=False))
        return read(planes=True)
    except (
        ArithmeticError,
        AttributeError,
        DataError,
        LookupError,
        MemoryError,
        OSError,
        RadarError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:  # exceptions of h5py and HDF5 for damaged files
        reason = one_line(error, 300)
        raise DataError(f"{path}: cannot read {wanted}: {reason or type(error).__name__}") from error


def write_grid(file: h5py.File, grid: ImageGrid) -> None:
    """Write the grid of an image, in the frame of the scene's file, and the anchor of that frame."""
    grid = grid.in_frame(np.zeros(3))
    group = file.create_group("grid")
    group.attrs["position"] = _POSITION[grid.kind]
    write_fields(group, grid, leave_out=("offset", "anchor"))
    write_fields(file.create_group("anchor"), grid.anchor)


def read_grid(file: h5py.File) -> ImageGrid:
    """Read the grid of an image.

    Raises
    ------
    DataError
        It is none.
    """
    anchor = read_fields(group_of(file, "anchor"), Anchor)
    grid = read_fields(group_of(file, "grid"), ImageGrid, offset=np.zeros(3), anchor=anchor)
    check_shape("grid", {"origin": (3,), "along": (3,), "across": (3,)}, grid)
    if grid.kind not in _POSITION or grid.azimuth.ndim != 1 or grid.range.ndim != 1:
        raise DataError(f"/grid: kind {grid.kind!r} with axes {grid.azimuth.shape} and {grid.range.shape}")
    return grid


def check_shape(where: str, shapes: Mapping[str, tuple[int, ...]], found: object) -> None:
    """Raise a DataError for arrays of other shapes; ``where``: group that they were read from."""
    for name, shape in shapes.items():
        has = getattr(found, name).shape
        if has != shape:
            raise DataError(f"/{where}/{name} has the shape {has}, not {shape}")
