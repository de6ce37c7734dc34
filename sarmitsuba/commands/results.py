"""The output folder of ``render`` and ``focus``: its files, and the contents of parameters.json."""

import dataclasses
import importlib.metadata
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from sarmitsuba import __version__
from sarmitsuba.commands.console import Console
from sarmitsuba.echo.raw import RawData
from sarmitsuba.errors import OutputError
from sarmitsuba.image.sar_image import SarImage
from sarmitsuba.io import parameters, write_image, write_raw
from sarmitsuba.io.atomic import make_folder
from sarmitsuba.radar.radar import Radar
from sarmitsuba.simulation.refinement.error_bars import with_error_bars
from sarmitsuba.timing import StageTimer

RAW, IMAGE, EXR = "raw.h5", "image.h5", "image.exr"
PICTURE, PICTURE_ORDERS, RECORD = "quicklook.png", "quicklook_order.png", "parameters.json"
PASSES = "passes.npz"  # of a run with a wanted error; a later run goes on from it
_ALL = (RAW, IMAGE, EXR, PICTURE, RECORD)
_PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "trimesh", "h5py", "OpenEXR", "matplotlib")


@contextmanager
def output_folder(path: str, *, force: bool) -> Iterator[Path]:
    """Yield the folder. It is made if needed, and removed again if nothing was put into it.

    Raises
    ------
    OutputError
        It holds files and ``force`` was not given, or it cannot be made or written to.
    """
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: this is a file, not a folder; choose another -o")
    existed = folder.is_dir()
    if existed and not force and any(path.name != PASSES for path in folder.iterdir()):
        raise OutputError(
            f"{folder}: this folder is not empty; choose another -o, or use --force to overwrite its results"
        )
    make_folder(folder)
    probe = folder / ".sarmitsuba.part"
    try:
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot write into this folder: {error.strerror}; choose another -o"
        ) from error
    try:
        yield folder
    finally:
        if not existed and not any(folder.iterdir()):
            folder.rmdir()


def clear_results(folder: Path, keep: Path | None = None) -> None:
    """Remove the results of an earlier run, so that old and new files never stand side by side."""
    for path in (*(folder / name for name in _ALL), *folder.glob("quicklook_*.png")):
        if keep is None or not keep.exists() or not path.exists() or not path.samefile(keep):
            path.unlink(missing_ok=True)


def save_raw(folder: Path, raw: RawData) -> None:
    """Write raw.h5."""
    write_raw(raw, folder / RAW)


def store_image(
    folder: Path, image: SarImage, watch: StageTimer, record: dict[str, object], console: Console
) -> Path:
    """Write the image as HDF5, OpenEXR and pictures, and add to the record. Return the first picture's path."""
    with watch.stage("error bars"):
        image = with_error_bars(image)
    errors = image.metadata.get("sampling_error", {})
    if errors:
        record["sampling_error"] = errors
        text = ", ".join(f"{channel} {bar['error_db']:.1f} dB" for channel, bar in errors.items())
        blocks = image.metadata.get("sampling", {}).get("block_error_db")
        apart = (
            "blocks of pulses" if blocks is None else f"blocks of pulses ({blocks:.1f} dB, measured apart)"
        )
        console.say(
            f"sampling error of the image: {text} (sampling with rays only; too few bounces, {apart}, gridding and "
            "physical optics are not in it)"
        )
    with watch.stage("write image"):
        write_image(image, folder / IMAGE)
        write_image(image, folder / EXR)
    with watch.stage("picture"):
        picture = save_pictures(folder, image)
    record["image"] = {
        "grid": image.grid.kind,
        "channels": image.channels,
        "shape": image.grid.shape,
        "azimuth_spacing_m": image.grid.azimuth_spacing,
        "range_spacing_m": image.grid.range_spacing,
        "azimuth_resolution_cell_m": image.azimuth_resolution_cell,
        "range_resolution_cell_m": image.range_resolution_cell,
    }
    return picture


def save_pictures(folder: Path, image: SarImage) -> Path:
    """Write quick-looks of every channel and of the bounce orders. Return the first channel's path."""
    from sarmitsuba.view.quicklook import bounce_orders, quicklook, quicklook_by_order, save

    save(quicklook(image), folder / PICTURE)
    for channel in image.channels[1:]:
        save(quicklook(image, channel=channel), folder / f"quicklook_{channel}.png")
    if bounce_orders(image):
        save(quicklook_by_order(image), folder / PICTURE_ORDERS)
    return folder / PICTURE


def save_record(folder: Path, record: Mapping[str, object]) -> None:
    """Write parameters.json."""
    parameters.write(folder / RECORD, record)


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
    """Return the radar's parameters, with units in their names. The track is summarised; raw.h5 has every pulse."""
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
        "n_pulses": track.n_pulses,
        "prf_hz": (track.n_pulses - 1) / span if span > 0 else None,
        "speed_m_per_s": float(np.linalg.norm(track.velocity[track.center_index])),
        "center_position_m": track.center_position,
        "aim_point_m": radar.aim_point,
        "slant_range_m": float(np.linalg.norm(radar.aim_point - track.center_position)),
        "near_range_m": float(window.start_range.min()),
        "far_range_m": float(window.start_range.max() + window.extent),
        "sampling_rate_hz": window.sampling_rate,
        "antenna": dataclasses.asdict(radar.antenna),
        "transmit_power_w": radar.transmit_power,
        "noise_temperature_k": radar.noise_temperature,
        "losses": radar.losses,
    }


__all__ = [
    "EXR",
    "IMAGE",
    "PASSES",
    "PICTURE",
    "PICTURE_ORDERS",
    "RAW",
    "RECORD",
    "clear_results",
    "output_folder",
    "radar_record",
    "save_pictures",
    "save_raw",
    "save_record",
    "store_image",
    "versions",
]
