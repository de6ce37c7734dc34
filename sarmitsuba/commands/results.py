"""The files that ``render`` and ``focus`` write, and the contents of parameters.json."""

import dataclasses
import importlib.metadata
import math
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba import __version__
from sarmitsuba.analysis.account import Account, StageTime, account
from sarmitsuba.analysis.image_quality import describe_weak_echoes
from sarmitsuba.commands.console import Console
from sarmitsuba.commands.image_arguments import PictureStyle
from sarmitsuba.commands.label_files import PICTURES, label_names, save_labels
from sarmitsuba.core.errors import DataError, SarmitsubaError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.core.timing import StageTimer
from sarmitsuba.files import FORMATS, FileFormat, read_raw, write_image, write_raw
from sarmitsuba.machine import output as parameter_file
from sarmitsuba.machine.output import OutputFolder
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.error_bars import add_error_bars
from sarmitsuba.view.display import LARGEST, SMALLEST, PictureOptions, magnification

if TYPE_CHECKING:
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.signal.focusing.comparison import Alternative
    from sarmitsuba.simulation.planning.prediction.needs import Needs
    from sarmitsuba.view.quicklook import Drawing

CHART = "accuracy.png"  # error by cause and time by stage
PICTURE, PICTURE_ORDERS, RECORD = "quicklook.png", "quicklook_order.png", "parameters.json"
BLOCKS = "raw.blocks"  # finished blocks of raw data that are being made
PASSES = "passes.npz"  # of a run with a wanted error; a later run goes on from it
RUN_HASH = "fingerprint"  # of scene, settings and program, in the metadata of raw data
# processor seconds of a usual core, and bytes: importing what draws; a picture, and each of its screen pixels
DRAWING, DRAWING_BYTES = 0.38, 28_000_000
DRAWN, DRAWN_PIXEL, PIXEL_BYTES, CHARTED = 0.06, 1.2e-7, 75, 0.15
# processor seconds of focusing from which other focusers are considered, and shortest stage shown, s
LONG_FOCUS, LEAST_STAGE = 1.0, 1e-3
# of a file, and of a byte in it
WRITTEN, WRITTEN_BYTE = 0.02, 2e-9
_PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "trimesh", "h5py", "OpenEXR", "matplotlib")


@dataclass(frozen=True)
class Formats:
    """File formats of a run's results: of raw data and of images.

    Parameters
    ----------
    raw, image : in the order asked for; never empty
    """

    raw: tuple[FileFormat, ...]
    image: tuple[FileFormat, ...]

    @staticmethod
    def parse(text: str) -> "Formats":
        """Read a list such as ``hdf5,openexr``.

        Raises
        ------
        ExtensionError
            There is no format of that name.
        DataError
            One cannot be written, or two would write the same file.
        """
        named = tuple(FORMATS[name.strip()] for name in text.split(","))
        for entry in named:
            if entry.write_raw is None and entry.write_image is None:
                raise DataError(f"--format {text}: {entry.name} can be read but not written")
        # data that none of them can hold are written as HDF5, which holds everything
        rest = (FORMATS["hdf5"],)
        found = Formats(
            tuple(entry for entry in named if entry.write_raw) or rest,
            tuple(entry for entry in named if entry.write_image) or rest,
        )
        names = [*found.names(raw=True), *found.names(raw=False)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise DataError(f"--format {text}: two of them would write {twice[0]}; name one of them")
        return found

    @property
    def on_a_map(self) -> bool:
        """Whether images are written as GeoTIFF, and so are masks."""
        return any(entry.name == "geotiff" for entry in self.image)

    def names(self, *, raw: bool) -> tuple[str, ...]:
        """Names of the files with raw data, or with images."""
        stem, formats = ("raw", self.raw) if raw else ("image", self.image)
        return tuple(f"{stem}{entry.suffixes[0]}" for entry in formats)


def expected_names(
    formats: Formats,
    channels: Sequence[str],
    *,
    raw: bool,
    image: bool,
    orders: bool,
    chart: bool,
    labels: bool = False,
) -> tuple[str, ...]:
    """Names of the files of a run: raw data, image with pictures, bounce orders, chart of its account, labels."""
    names = [RECORD]
    if raw:
        names += formats.names(raw=True)
    if image:
        names += [name for entry in formats.image for name in entry.names("image", channels)]
        names += [picture_name(channels, c) for c in channels]
        names += [PICTURE_ORDERS] if orders else []
        names += [CHART] if chart else []
        names += label_names(geotiff=formats.on_a_map) if labels else ()
    return tuple(names)


def least_bytes(scene: "Scene", formats: Formats, *, raw: bool, image: bool, chirped: bool = False) -> float:
    """Least size of the results in bytes: every channel, and again for its ray subsets; without bounce orders.

    Raw data count twice, for their finished blocks; ``chirped`` ones are longer by the pulse.
    """
    from sarmitsuba.signal.chirp import n_fast_chirped
    from sarmitsuba.signal.focusing import default_grid

    subsets = scene.settings.keep_subsets and scene.traced
    planes = len(scene.radar.channels) * (3 if subsets else 1)
    blocks = total = 0.0
    if raw:
        blocks = scene.radar.track.n_pulses * scene.radar.window.n_samples * len(scene.radar.channels)
        blocks *= 2 if subsets else 1
    if raw and any(entry.name == "hdf5" for entry in formats.raw):
        samples = n_fast_chirped(scene.radar) if chirped else scene.radar.window.n_samples
        total += scene.radar.track.n_pulses * samples
    if image and any(entry.name == "hdf5" for entry in formats.image):
        total += float(np.prod(default_grid(scene.radar, scene.image).shape))
    return 8.0 * (planes * total + blocks)


def save_raw(folder: OutputFolder, raw: RawData, formats: Formats, leave_out: Sequence[Path] = ()) -> None:
    """Write the raw data in every requested format, except files that hold them already."""
    for entry, name in zip(formats.raw, formats.names(raw=True), strict=True):
        if folder.path / name in leave_out:
            continue
        with folder.writing(name) as path:
            write_raw(raw, path, format=entry.name)


def saved_raw(
    folder: OutputFolder, formats: Formats, run_hash: str, console: Console
) -> tuple[Path, RawData] | None:
    """Saved raw data of the same run hash, and their file; None where there are none.

    Parameters
    ----------
    run_hash : of the scene, its settings and the program; only data that carry the same are the same
    """
    for entry, name in zip(formats.raw, formats.names(raw=True), strict=True):
        path = folder.path / name
        if entry.read_raw is None or not folder.owns(name) or folder.run_hash != run_hash:
            continue
        try:
            raw = read_raw(path, format=entry.name)
        except DataError as error:
            console.warn(f"{error}; simulating anew")
            continue
        if raw.metadata.get(RUN_HASH) == run_hash:
            return path, raw
    return None


def _format_error_bar(bar: Mapping[str, float]) -> str:
    """Text of an error bar."""
    bound = f", at most {bar['at_most_db']:.1f} dB" if "at_most_db" in bar else ""
    return f"{bar['error_db']:.1f} dB +- {bar['confidence_db']:.1f} dB{bound}"


def add_file_needs(
    needs: "Needs", formats: Formats, channels: Sequence[str], *, image: bool, chart: bool = True
) -> "Needs":
    """Predicted needs of a run including the writing of files and pictures (stage ``files``).

    Parameters
    ----------
    needs : time and memory of simulating and focusing
    formats : that are written
    channels : each has a picture
    image : whether the raw data are focused, or there are none
    chart : whether a chart of the image's account is drawn
    """
    count = len(formats.raw) * (needs.raw_bytes > 0)
    planes = needs.layers // len(channels)
    # a channel in several planes has one more picture, of their sum
    plane = needs.raw_bytes / needs.layers if planes > 1 else 0.0
    written = (needs.raw_bytes + plane * len(channels)) * count
    seconds, size = 0.0, plane
    if image:
        sides = [n * step for n, step in zip(needs.image_shape, needs.pixel_spacing, strict=True)]
        finest = max(*sides) / LARGEST  # m, of a screen pixel
        height, width = (side / max(min(needs.pixel_spacing), finest) for side in sides)
        shown = height * width * magnification(width, height, LARGEST, SMALLEST) ** 2
        count, written = count + len(formats.image), written + 8 * needs.pixels * len(formats.image)
        seconds = DRAWING + CHARTED * chart + len(channels) * (DRAWN + DRAWN_PIXEL * shown)
        size = max(size, DRAWING_BYTES + PIXEL_BYTES * shown)
    seconds += count * WRITTEN + written * WRITTEN_BYTE
    return (needs if image else needs.without_focus).then("files", seconds, size)


def store_image(
    folder: OutputFolder,
    image: SarImage,
    formats: Formats,
    watch: StageTimer,
    record: dict[str, object],
    console: Console,
    *,
    chart: bool,
    style: PictureStyle,
    others: Callable[[], Sequence["Alternative"]] = tuple,
) -> Path:
    """Write the image in every requested format, its pictures and the record. Return the first picture's path.

    Parameters
    ----------
    style : of the pictures
    chart : whether to draw the account of error and time
    others : gives focusers in place of the one used; called only where focusing takes long
    """
    with watch.stage("error bars"):
        image = add_error_bars(image)
    errors = image.metadata.get("sampling_error", {})
    if errors:
        record["sampling_error"] = errors
        text = ", ".join(f"{channel} {_format_error_bar(bar)}" for channel, bar in errors.items())
        source = next(iter(errors.values()))["source"]
        console.say(f"sampling error of the image, measured here: {text} ({source})")
    found = _account(image, watch, others)
    parts = found.parts
    record["errors"] = {part.name: part.as_dict() for part in parts}
    console.say(f"errors: {'; '.join(map(str, parts))}")
    for text in found.advice:
        console.say(text)
    for note in describe_weak_echoes(image):
        console.note(f"{image.metadata.get('scene', 'image')}: {note}")
    failed: list[SarmitsubaError] = []
    with watch.stage("write image"):
        for entry, name in zip(formats.image, formats.names(raw=False), strict=True):
            try:
                with folder.writing(name) as path:
                    write_image(image, path, format=entry.name)
            except SarmitsubaError as error:  # the other formats are written first
                failed.append(error)
    record["image"] = {
        "grid": image.grid.kind,
        "channels": image.channels,
        "shape": image.grid.shape,
        "azimuth_spacing_m": image.grid.azimuth_spacing,
        "range_spacing_m": image.grid.range_spacing,
        "azimuth_resolution_cell_m": image.azimuth_resolution_cell,
        "range_resolution_cell_m": image.range_resolution_cell,
    }
    # expensive results first, pictures last; the record is written again at the end with times and warnings
    record["account"] = found.as_dict()
    save_record(folder, record)
    if failed:
        raise failed[0]
    with watch.stage("picture"):
        path = save_pictures(folder, image, console, style)
    found = dataclasses.replace(found, stages=stage_times(image, watch))
    record["account"] = found.as_dict()
    if style.labelled and style.scene is not None:
        from sarmitsuba.view.labels_picture import labels_figure

        with watch.stage("labels"):
            labels = save_labels(
                folder, image, style.scene, console, classes=style.classes, geotiff=formats.on_a_map
            )
            options = style.options(PictureOptions())
            for name, layer in PICTURES.items():
                if layer in labels.layers:
                    draw_into(folder, name, partial(labels_figure, image, labels, layer, options), console)
    if chart:
        from sarmitsuba.view.charts import account_figure

        title = f"{image.metadata['scene']}: " if image.metadata.get("scene") else ""
        with watch.stage("chart"):
            draw_into(folder, CHART, partial(account_figure, found, title), console)
    return path


def _account(image: SarImage, watch: StageTimer, others: Callable[[], Sequence["Alternative"]]) -> Account:
    """Account of an image, before its files are written."""
    asked = others() if watch.processor.get("focus", 0.0) >= LONG_FOCUS else ()
    return account(image, stage_times(image, watch), asked)


def stage_times(image: SarImage, watch: StageTimer) -> dict[str, StageTime]:
    """Time by stage of a command; its simulation by the stages in the image's metadata.

    The simulation of raw data that were made before is left out.
    """
    times = {
        name: StageTime(s, watch.processor[name]) for name, s in watch.seconds.items() if s >= LEAST_STAGE
    }
    whole = times.get("simulate")
    elapsed, used = (image.metadata.get(name) for name in ("seconds", "processor_seconds"))
    if whole is None or not isinstance(elapsed, Mapping) or not isinstance(used, Mapping):
        return times
    parts = {name: StageTime(s, used.get(name, math.nan)) for name, s in elapsed.items() if s >= LEAST_STAGE}
    left = [whole.elapsed - sum(t.elapsed for t in parts.values())]
    left.append(whole.processor - sum(t.processor for t in parts.values()))
    if left[0] >= LEAST_STAGE:
        parts["simulate, other"] = StageTime(left[0], left[1])
    found: dict[str, StageTime] = {}
    for name, stage in times.items():
        found |= parts if name == "simulate" else {name: stage}
    return found


def save_pictures(folder: OutputFolder, image: SarImage, console: Console, style: PictureStyle) -> Path:
    """Write quick-looks of every channel and of the bounce orders. Return the first channel's path."""
    from sarmitsuba.view.quicklook import bounce_orders, quicklook_by_order

    for channel in image.channels:
        name = picture_name(image.channels, channel)
        draw_into(folder, name, partial(style.figure, image, PictureOptions(channel=channel)), console)
    if bounce_orders(image):
        draw_into(
            folder,
            PICTURE_ORDERS,
            partial(quicklook_by_order, image, style.options(PictureOptions())),
            console,
        )
    return folder.path / PICTURE


def draw_into(folder: OutputFolder, name: str, draw: "Drawing", console: Console) -> Path:
    """Write a picture into the folder and return its path; one that cannot be drawn gives a warning, not an error.

    Raises
    ------
    OutputError
        The file cannot be written, or a file that this program did not write has that name.
    """
    from sarmitsuba.view.quicklook import save

    path = folder.path / name
    try:
        with folder.writing(name) as path:
            save(draw(), path)
    except SarmitsubaError:
        raise
    except (
        ArithmeticError,
        AssertionError,
        AttributeError,
        ImportError,
        LookupError,
        MemoryError,
        OSError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:  # any error of the drawing library
        reason = one_line(error, 200) or type(error).__name__
        console.warn(f"{path}: the picture could not be drawn ({reason}); the results are saved")
    return path


def picture_name(channels: Sequence[str], channel: str | None) -> str:
    """File name of a channel's quick-look."""
    return PICTURE if channel in (None, channels[0]) else f"quicklook_{channel}.png"


def save_record(folder: OutputFolder, record: Mapping[str, object]) -> None:
    """Write parameters.json."""
    with folder.writing(RECORD) as path:
        parameter_file.write(path, record)


def versions() -> dict[str, str]:
    """Return the versions of this program, Python and the packages that the result depends on."""
    found = {"sarmitsuba": __version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def radar_record(radar: Radar) -> dict[str, object]:
    """Return the radar's parameters, with units in their names and positions in the frame of the scene's file.

    The track is summarised; raw.h5 has every pulse.
    """
    radar = radar.in_file_frame()
    track, window = radar.track, radar.window
    span = float(track.time[-1] - track.time[0])
    return {
        "mode": radar.mode,
        "look_side": radar.look_side,
        "channels": radar.channels,
        "center_frequency_hz": radar.waveform.center_frequency,
        "wavelength_m": radar.waveform.wavelength,
        "bandwidth_hz": radar.waveform.bandwidth,
        "pulse_width_s": radar.waveform.pulse_width,
        "pulse_form": radar.waveform.code or radar.waveform.sweep,
        "n_pulses": track.n_pulses,
        "prf_hz": (track.n_pulses - 1) / span if span > 0 else None,
        "speed_m_per_s": float(np.linalg.norm(track.velocity[track.center_index])),
        "center_position_m": track.center_position,
        "aim_point_m": radar.aim_point,
        "anchor": {
            "latitude_deg": float(np.degrees(radar.anchor.latitude)),
            "longitude_deg": float(np.degrees(radar.anchor.longitude)),
            "height_m": radar.anchor.height,
        },
        "slant_range_m": float(np.linalg.norm(radar.aim_point - track.center_position)),
        "near_range_m": float(window.start_range.min()),
        "far_range_m": float(window.start_range.max() + window.extent),
        "sampling_rate_hz": window.sampling_rate,
        "antenna": dataclasses.asdict(radar.antenna),
        "transmit_power_w": radar.transmit_power,
        "noise_temperature_k": radar.noise_temperature,
        "losses": radar.losses,
        "emitters": 0 if radar.emitters is None else radar.emitters.kind.size,
        "receive_chain": None
        if radar.chain is None
        else {name: getattr(radar.chain, name) for name in radar.chain.given},
    }
