"""SICD 1.3, the NGA standard for complex images (NITF): writing and reading; see docs/files.md.

One file holds one polarisation. Pixels are those of the image times ``exp(-j 2 pi K . x)`` with the centre K of their
spatial frequencies (``KCtr``) and x relative to the scene centre point: the standard requires baseband pixels, while
backprojected pixels have the carrier.
"""

from pathlib import Path
from types import ModuleType

import numpy as np

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.errors import DataError
from sarmitsuba.files.formats import FORMATS, FileFormat
from sarmitsuba.files.labelled import formats_package
from sarmitsuba.files.nga import plain_xml, read_apart, refuse_document_type
from sarmitsuba.files.sicd_document import Axes, document, image_of
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.radar.collection import Collection, flight_facts, signal_facts
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.image import SarImage


def write_image(path: Path, image: SarImage) -> None:
    """Write an image; several channels are written to separate files, ``NAME_HH.nitf`` and so on.

    Raises
    ------
    DataError
        The image has no flight metadata, its pixels are in slant range of a track that is not straight and level, or
        sarkit is missing.
    """
    sarkit = formats_package("sarkit.sicd", f"{path}: SICD files need")
    flight = Collection.read(image.metadata.get("focus", {}), str(path))
    against = _describe_without_grid(image.grid.kind, flight)
    if against:
        raise DataError(f"{path}: {against}")
    for channel in image.channels:
        target = path if len(image.channels) == 1 else path.with_name(f"{path.stem}_{channel}{path.suffix}")
        tree = document(image, channel, flight, target.stem)
        security = sarkit.NitfSecurityFields(clas="U")
        metadata = sarkit.NitfMetadata(
            xmltree=tree,
            file_header_part=sarkit.NitfFileHeaderPart(ostaid="sarmitsuba", security=security),
            im_subheader_part=sarkit.NitfImSubheaderPart(isorce="sarmitsuba", security=security),
            de_subheader_part=sarkit.NitfDeSubheaderPart(security=security),
        )
        pixels = baseband(image.total(channel), Axes.of(image, flight))
        with (
            atomic_path(target) as temporary,
            temporary.open("wb") as file,
            sarkit.NitfWriter(file, metadata) as writer,
        ):
            writer.write_image(pixels)


def objection(radar: Radar, kind: str) -> str:
    """Reason why an image on a kind of grid cannot be written, for checks before a run; empty where it can."""
    return _describe_without_grid(
        kind, Collection.read({**signal_facts(radar), **flight_facts(radar)}, "the radar")
    )


def _describe_without_grid(kind: str, flight: Collection) -> str:
    if kind != "slant" or flight.straight_and_level:
        return ""
    return (
        "the track is curved or climbs, for which SICD has no slant-range grid; set image_grid = ground in the "
        "range_film (-D range_film.image_grid=ground), or focus the raw data with --grid ground"
    )


def baseband(pixels: C64, axes: Axes) -> C64:
    """Convert pixels (azimuth, range) to the baseband pixels (rows, columns) of the file."""
    array = (pixels[::-1] if axes.turned else pixels).T
    rows, columns = axes.ramp(array.shape)
    return np.asarray(array * np.exp(-2j * np.pi * rows)[:, None] * np.exp(-2j * np.pi * columns)).astype(
        np.complex64
    )


def read_image(path: Path) -> SarImage:
    """Read an image on a uniform grid of the ground, or of a straight track's slant range.

    Raises
    ------
    DataError
        The file is damaged or of another format, its pixels are on another grid, or sarkit is missing.

    Notes
    -----
    ``sigma0`` uses the incidence angle of the scene centre point at every pixel; of the radiometric polynomials only a
    constant RCS factor is applied.
    """
    sarkit = formats_package("sarkit.sicd", f"{path}: SICD files need")
    return read_apart(path, "SICD", lambda: _read(path, sarkit))


def _read(path: Path, sarkit: ModuleType) -> SarImage:
    """Image of a file."""
    with path.open("rb") as file, plain_xml(), sarkit.NitfReader(file) as reader:
        tree = reader.metadata.xmltree
        refuse_document_type(tree, str(path))
        rows, columns = (int(tree.findtext(f"{{*}}ImageData/{{*}}Num{what}")) for what in ("Rows", "Cols"))
        size = path.stat().st_size
        if rows <= 0 or columns <= 0 or 2 * rows * columns > size:  # 2 bytes each
            raise DataError(
                f"{path}: {rows} x {columns} pixels do not fit into the {size} bytes of the file; it is damaged"
            )
        pixels = np.asarray(reader.read_image())
    if pixels.dtype.names == ("real", "imag"):  # RE16I_IM16I
        pixels = pixels["real"] + 1j * pixels["imag"].astype(np.float32)
    if not np.iscomplexobj(pixels):
        raise DataError(
            f"{path}: pixels by amplitude and phase tables are not supported; convert them to RE32F_IM32F"
        )
    return image_of(sarkit.ElementWrapper(tree.getroot()), pixels.astype(np.complex64), str(path))


FORMATS.register(
    FileFormat(
        name="sicd",
        doc="SICD 1.3: complex images for other tools, one polarisation per file (extra: formats)",
        suffixes=(".nitf", ".ntf"),
        write_image=write_image,
        read_image=read_image,
        per_channel=True,
        objection=objection,
    )
)
