"""HDF5 files of raw data and images, with all metadata; layout in docs/files.md.

HDF5 because it is a published standard that MATLAB, Julia, IDL, C and Python read without this package,
stores its own structure and units, and reads a range of pulses without the rest (chunks). Complex numbers are
the usual compound of ``r`` and ``i``.

One dataset per channel is the complete image (``/image/VV``) or echoes (``/echoes/VV``). Parts are stored separately:
bounce orders in ``/orders/VV/2``, ray subsets in ``/subsets/1``. ``/layers`` names the planes of an object in memory;
sums are written in addition and not read.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sarmitsuba.core.arrays import C64, check_pulses
from sarmitsuba.core.constants import SUBSET_SHARES
from sarmitsuba.core.errors import DataError
from sarmitsuba.files import hdf5_file as groups
from sarmitsuba.files.formats import FORMATS, FileFormat
from sarmitsuba.files.hdf5_file import check_shape, read_grid, read_hdf5, write_grid, write_hdf5
from sarmitsuba.machine.encoding import json_value, to_json
from sarmitsuba.machine.regular_files import check_unpacked
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.raw_data import AutofocusRecords, Layer, RawData, channels_of

# fields of a radar that are stored elsewhere
_ELSEWHERE = ("track", "offset", "recorded", "receiver", "receiver_pointing", "delay", "anchor")
_CHUNK_BYTES = 1 << 20  # HDF5's default chunk cache holds one such chunk
_PATH = re.compile(r"/(?:subsets/([12])/)?(?:(?:image|echoes)/(\w+)|orders/(\w+)/([1-9]\d{0,5}))")
_SUBSETS = (
    "Two independent subsets of the rays, for error bars. Each holds its share (attribute) of the whole: they add up "
    "to the plane of the same name outside this group, which is the one to use. Divided by its share, a subset is a "
    "coarser independent estimate."
)
_ORDERS = "Parts of every channel by number of bounces; over all bounces they add up to the channel."


@dataclass(frozen=True)
class _Kind:
    """Description of a file's planes.

    Parameters
    ----------
    root : group of the channels
    axes : names of the axes of a plane
    unit, description : of its values
    scales : datasets with the coordinates of the axes; empty: none
    """

    root: str
    axes: tuple[str, str]
    unit: str
    description: str
    scales: tuple[str, str]


_IMAGE = _Kind(
    "image",
    ("azimuth", "range"),
    "m",
    "calibrated complex image: |pixel|^2 is the radar cross section, m^2, of a point at its peak",
    ("grid/azimuth", "grid/range"),
)
_ECHOES = _Kind("echoes", ("pulse", "sample"), "sqrt(W)", "received echoes", ("track/time", ""))


def write_image(path: Path | str, image: SarImage) -> None:
    """Write an image, positions in the frame of the scene's file."""

    def fill(file: h5py.File) -> None:
        write_grid(file, image.grid)
        group = file.create_group("calibration")
        for name in ("wavelength", "azimuth_resolution_cell", "range_resolution_cell", "incidence_angle"):
            groups.write_number(group, name, getattr(image, name))
        area = image.cell_area
        # a single row if all rows are equal
        groups.write_number(group, "cell_area", area[0] if area.strides[0] == 0 else area.astype(np.float32))
        _write_planes(file, _IMAGE, image.data, image.layers)
        _write_metadata(file, image.metadata)

    write_hdf5(path, "image", fill)


def write_raw(path: Path | str, raw: RawData) -> None:
    """Write raw data, positions in the frame of the scene's file."""

    def fill(file: h5py.File) -> None:
        radar = raw.radar.in_file_frame()
        groups.write_fields(file.create_group("radar"), radar, leave_out=_ELSEWHERE)
        groups.write_fields(file.create_group("anchor"), radar.anchor)
        groups.write_fields(file.create_group("track"), radar.track)
        if radar.receiver is not None:
            group = file.create_group("receiver_track")
            groups.write_fields(group, radar.receiver)
            if radar.delay is not None:
                groups.write_number(group, "delay", radar.delay)
        if radar.receiver_pointing is not None:
            groups.write_fields(file.create_group("receiver_pointing"), radar.receiver_pointing)
        if raw.flown is not None:
            flown = replace(raw.flown, position=raw.flown.position + raw.radar.offset)
            groups.write_fields(file.create_group("flown_track"), flown)
        if raw.request is not None:
            asked = raw.request.in_frame()
            groups.write_fields(file.create_group("image_request"), asked, ("offset",))
        for channel, records in raw.autofocus_records.items():
            groups.write_fields(file.create_group(f"autofocus_records/{channel}"), records)
        _write_planes(file, _ECHOES, raw.data, raw.layers)
        file[_ECHOES.root].attrs["domain"] = raw.domain
        _write_metadata(file, raw.metadata)

    write_hdf5(path, "raw data", fill)


def read_image(path: Path | str) -> SarImage:
    """Read an image written by :func:`write_image`."""

    def load(file: h5py.File, planes: bool) -> SarImage:
        grid = read_grid(file)
        data, layers = _read_planes(file, _IMAGE, planes)
        facts = groups.group_of(file, "calibration")
        incidence = groups.numbers(facts, "incidence_angle")
        if data.shape[1:] != grid.shape or incidence.shape != grid.range.shape:
            raise DataError(f"planes {data.shape[1:]} do not match the grid {grid.shape}")
        return SarImage(
            data,
            layers,
            grid,
            groups.number(facts, "wavelength", float),
            groups.number(facts, "azimuth_resolution_cell", float),
            groups.number(facts, "range_resolution_cell", float),
            incidence,
            _read_metadata(file),
        )

    return read_hdf5(path, "image", "an image", load)


def read_raw(path: Path | str) -> RawData:
    """Read raw data written by :func:`write_raw`."""

    def load(file: h5py.File, planes: bool) -> RawData:
        track = groups.read_fields(groups.group_of(file, "track"), Track)
        receiver, flown = (
            groups.read_fields(groups.group_of(file, name), Track) if groups.has(file, name) else None
            for name in ("receiver_track", "flown_track")
        )
        aside = "receiver_pointing"
        anchor = groups.read_fields(groups.group_of(file, "anchor"), Anchor)
        known = {
            "track": track,
            "offset": np.zeros(3),
            "recorded": None,
            "receiver": receiver,
            "delay": groups.numbers(file["receiver_track"], "delay")
            if receiver is not None and groups.has(file["receiver_track"], "delay")
            else None,
            "anchor": anchor,
            aside: groups.read_fields(groups.group_of(file, aside), Pointing)
            if groups.has(file, aside)
            else None,
        }
        radar = groups.read_fields(groups.group_of(file, "radar"), Radar, **known)
        pulses = (track.n_pulses, 3)
        check_shape("radar", {"aim_point": (3,)}, radar)
        check_shape("radar/window", {"start_range": pulses[:1]}, radar.window)
        axes = {"boresight": pulses, "azimuth_axis": pulses, "elevation_axis": pulses}
        check_shape("radar/pointing", axes, radar.pointing)
        if radar.receiver_pointing is not None:
            check_shape(aside, axes, radar.receiver_pointing)
        data, layers = _read_planes(file, _ECHOES, planes)
        (domain,) = groups.texts_of(groups.group_of(file, _ECHOES.root), "domain")
        if domain not in ("compressed", "chirped") or (
            domain == "compressed" and data.shape[2] != radar.window.n_samples
        ):
            raise DataError(f"{domain} echoes of {data.shape[2]} samples do not match /radar/window")
        asked = groups.has(file, "image_request")
        request = (
            groups.read_fields(groups.group_of(file, "image_request"), ImageRequest, offset=(0.0, 0.0, 0.0))
            if asked
            else None
        )
        metadata = _read_metadata(file)
        if planes:
            check_pulses(data)
        records = {}
        if groups.has(file, "autofocus_records"):
            aside_group = groups.group_of(file, "autofocus_records")
            records = {
                str(name): groups.read_fields(groups.group_of(aside_group, name), AutofocusRecords)
                for name in aside_group
            }
        return RawData(data, layers, domain, radar, metadata, request, flown, records)  # type: ignore[arg-type]

    return read_hdf5(path, "raw data", "raw data", load)


def _write_planes(file: h5py.File, kind: _Kind, data: C64, layers: Sequence[Layer]) -> None:
    """Write every layer, and the sums that are not layers themselves."""
    paths = [_path_of(layer, kind.root) for layer in layers]
    sums: dict[str, tuple[str, int | None]] = {
        _path_of(Layer(name), kind.root): (name, None) for name in channels_of(layers)
    }
    sums |= {
        _path_of(Layer(e.channel, e.order), kind.root): (e.channel, e.order) for e in layers if e.order > 0
    }
    made: dict[str, list[int]] = {path: [i] for i, path in enumerate(paths)}
    for path, (channel, order) in sums.items():
        picks = [
            i for i, e in enumerate(layers) if e.channel == channel and (order is None or e.order == order)
        ]
        if path in made and picks != made[path]:
            raise DataError(
                f"layers: {path} is both a sum and a part; keep either all orders and subsets separate, or none"
            )
        made[path] = picks
    if len(set(paths)) < len(paths):
        raise DataError("layers: two have the same channel, order and subset; sum them")
    _make_scales(file, kind)
    for path, picks in made.items():
        plane = data[picks[0]]
        if len(picks) > 1:  # one plane at a time, without a copy of all of them
            plane = plane.copy()
            for i in picks[1:]:
                plane += data[i]
        _write_plane(file, kind, path, plane)
    file[kind.root].attrs["description"] = kind.description
    if "orders" in file:
        file["orders"].attrs["description"] = _ORDERS
    if "subsets" in file:
        file["subsets"].attrs["note"] = _SUBSETS
        for name in file["subsets"]:
            file[f"subsets/{name}"].attrs["share"] = SUBSET_SHARES[int(name)]
    file["layers"] = paths
    file["layers"].attrs["description"] = "planes kept separate when the file is read"


def _path_of(layer: Layer, root: str) -> str:
    subset = f"/subsets/{layer.subset}" if layer.subset else ""
    name = f"orders/{layer.channel}/{layer.order}" if layer.order else f"{root}/{layer.channel}"
    return f"{subset}/{name}"


def _make_scales(file: h5py.File, kind: _Kind) -> None:
    for axis, scale in zip(kind.axes, kind.scales, strict=True):
        if scale:
            file[scale].make_scale(axis)


def _write_plane(file: h5py.File, kind: _Kind, path: str, plane: C64) -> None:
    row_bytes = max(1, plane.shape[1] * plane.itemsize)
    rows = int(np.clip(_CHUNK_BYTES // row_bytes, 1, max(1, plane.shape[0])))
    # not compressed: echoes and speckle are incompressible
    made = file.create_dataset(path, data=plane, chunks=(rows, plane.shape[1]) if plane.size else None)
    made.attrs["axes"], made.attrs["unit"] = ", ".join(kind.axes), kind.unit
    for i, (axis, scale) in enumerate(zip(kind.axes, kind.scales, strict=True)):
        made.dims[i].label = axis
        if scale:
            made.dims[i].attach_scale(file[scale])


def _check_share(file: h5py.File, subset: str | None) -> None:
    """Refuse ray subsets of other shares than this program's: their error would be stated wrong."""
    if not subset:
        return
    share = groups.group_of(groups.group_of(file, "subsets"), subset).attrs.get("share")
    if share is not None and share != SUBSET_SHARES[int(subset)]:
        raise DataError(
            f"ray subset {subset} has another share than {SUBSET_SHARES[int(subset)]:g}; simulate again"
        )


def _read_planes(file: h5py.File, kind: _Kind, planes_too: bool) -> tuple[C64, tuple[Layer, ...]]:
    """Planes named in ``/layers``, or without it the channels; without ``planes_too`` zeros without memory."""
    if groups.has(file, "layers"):
        names = groups.dataset(file, "layers").asstr()[()]
        paths = [str(name) for name in np.atleast_1d(names)]
    else:
        paths = [f"/{kind.root}/{name}" for name in groups.group_of(file, kind.root)]
    if len(set(paths)) < len(paths):
        raise DataError("/layers names a plane twice")
    layers, planes = [], []
    for path in paths:
        match = _PATH.fullmatch(path)
        if match is None:
            raise DataError(f"/layers: {path!r} is no plane")
        subset, channel, channel_of_order, order = match.groups()
        layers.append(Layer(channel or channel_of_order, int(order or 0), int(subset or 0)))
        _check_share(file, subset)
        group = file
        *folders, last = path.strip("/").split("/")
        for folder in folders:
            group = groups.group_of(group, folder)
        plane = groups.dataset(group, last)
        if plane.dtype != np.complex64 or plane.ndim != 2 or 0 in plane.shape:
            raise DataError(f"{path} is {plane.dtype} of shape {plane.shape}, not a plane of complex64")
        planes.append(plane)
    if not planes or len({plane.shape for plane in planes}) > 1:
        raise DataError("no planes, or planes of several shapes")
    shape = (len(planes), *planes[0].shape)
    check_unpacked(math.prod(shape) * planes[0].dtype.itemsize, file.id.get_filesize())
    if not planes_too:
        for plane in planes:
            if plane.chunks is not None:
                plane.id.get_num_chunks()  # reads the index of chunks
        return np.broadcast_to(np.complex64(0.0), shape), tuple(layers)
    data = np.empty(shape, dtype=np.complex64)
    for row, plane in zip(data, planes, strict=True):
        plane.read_direct(row)
    return data, tuple(layers)


def _write_metadata(file: h5py.File, metadata: Mapping[str, object]) -> None:
    file["metadata"] = json.dumps(to_json(metadata))
    file["metadata"].attrs["encoding"] = "JSON"
    file["metadata"].attrs["description"] = "origin of the data: settings, effects, notes, seconds"


def _read_metadata(file: h5py.File) -> dict[str, Any]:
    facts = json_value(groups.dataset(file, "metadata").asstr()[()]) if groups.has(file, "metadata") else {}
    if not isinstance(facts, dict):
        raise DataError("/metadata is not a JSON object")
    return facts


FORMATS.register(
    FileFormat(
        "hdf5",
        "complete data, readable again; the standard of scientific data",
        (".h5", ".hdf5"),
        write_raw=write_raw,
        read_raw=read_raw,
        write_image=write_image,
        read_image=read_image,
    )
)
