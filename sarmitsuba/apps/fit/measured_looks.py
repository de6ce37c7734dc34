"""Looks of a fit: measured raw data, each with the model of the scene that its radar sees by the rays of the data."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.jacobian import Parameters, parameters_of
from sarmitsuba.apps.fit.least_squares import Samples
from sarmitsuba.core.arrays import C64
from sarmitsuba.core.errors import DataError, SarmitsubaWarning, SceneError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.receiver import moving_in_pulse
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.signal.noise import noise_power
from sarmitsuba.signal.raw_data import RawData

# largest relative difference of the centre frequencies of data and scene
SAME_CARRIER = 1e-6
# share of the wavelength by which the tracks of both may differ, and relative difference of other numbers
SAME_TRACK, SAME_NUMBER = 1e-3, 1e-6
# settings of a run that decide its rays and scatterers, as its raw data record them
OF_RAYS = (
    "seed",
    "pass_days",
    "method",
    "gridding_width",
    "ray_spacing",
    "diffuse_ray_spacing",
    "scatterer_cell",
)
# noise power relative to that of the data that priors are weighed against at least
LEAST_NOISE = 1e-6
# rounding of float32 data, as a share of that
ROUNDING = 2.0**-48 / LEAST_NOISE


@dataclass(frozen=True)
class NoisePower:
    """Noise of raw data: power of a sample as the radar states it, W (0: not stated), and least power that counts.

    ``samples`` : of a range cell, which are alike, as the noise is flat over the band alone
    """

    stated: float
    least: float
    samples: float

    @staticmethod
    def of(scene: Scene, measured: C64) -> NoisePower:
        """Noise of a scene's radar; at least ``LEAST_NOISE`` of the measured power."""
        radar = scene.radar
        return NoisePower(
            noise_power(radar, "compressed"),
            LEAST_NOISE * float(np.mean(np.abs(measured) ** 2)),
            max(float(radar.waveform.range_cell / radar.window.sample_spacing), 1.0),
        )

    def of_power(self, power: float) -> float:
        """Variance within the band, from the mean power of a sample."""
        return power * self.samples

    def variance(self, difference: Samples) -> float:
        """Variance that priors and looks are weighed by: as stated, else as the residuals show."""
        shown = max(float(np.mean(np.abs(difference) ** 2)), self.least)
        return self.of_power(self.stated if self.stated > 0.0 else shown)

    def shown(self, difference: Samples) -> float:
        """Variance that the residuals show, at least the rounding of float32."""
        return self.of_power(max(float(np.mean(np.abs(difference) ** 2)), ROUNDING * self.least))


@dataclass(frozen=True, eq=False)
class MeasuredLook:
    """Measured raw data of one radar with the model of the scene that it sees.

    Parameters
    ----------
    model : of the scene
    data : as given
    measured : (channels, pulses, samples), their layers of a channel summed
    noise : of the data
    """

    model: ForwardModel
    data: RawData
    measured: C64
    noise: NoisePower

    @staticmethod
    def of(scene: Scene, data: RawData, parameters: Parameters) -> MeasuredLook:
        """Model of a scene, checked against the data."""
        model = ForwardModel(scene, parameters_of(parameters, scene))
        measured = _planes(model, data)
        return MeasuredLook(model, data, measured, NoisePower.of(scene, measured))

    def residual(self, difference: Samples) -> RawData:
        """A difference (channels, pulses, samples) as raw data."""
        return replace(self.model.raw(difference.astype(np.complex64)), request=self.data.request)


def looks_of(
    scenes: SceneLike | Sequence[SceneLike], data: RawData | Sequence[RawData], parameters: Parameters
) -> tuple[MeasuredLook, ...]:
    """Looks from a scene for each raw data, or from one scene, which every radar of several raw data sees.

    The radar is that of the data, with fields that parameters change as the scene has them, and so are ray sets,
    spacings and seed where the data record them, as those of simulations do. Where a look's scene has another radar
    a warning says how it differs.

    Raises
    ------
    SceneError : another number of scenes than of data; shapes, materials or parameters that the looks do not share
    DataError : see :func:`sarmitsuba.fit`
    """
    measured = (data,) if isinstance(data, RawData) or not isinstance(data, Iterable) else tuple(data)
    for one in measured:
        if not isinstance(one, RawData):
            raise DataError(
                f"fit: raw data are expected, as simulate() or read_raw() give, not {type(one).__name__}"
            )
    if isinstance(scenes, Scene | Path | str) or not isinstance(scenes, Iterable):
        given: tuple[SceneLike, ...] = (scenes,)
    else:
        given = tuple(scenes)
    if not measured:
        raise DataError("fit: there are no raw data; give those of one look at least")
    loaded = [Scene.of(scene) for scene in given]
    shared = len(loaded) == 1 < len(measured)
    if shared:
        loaded = loaded * len(measured)
    if len(loaded) != len(measured):
        raise SceneError(
            f"fit: {len(loaded)} scenes and {len(measured)} raw data; give a scene for each, or one for all"
        )
    looks = []
    for scene, one in zip(loaded, measured, strict=True):
        _check_band(scene, one)
        fitted = {name for p in parameters_of(parameters, scene) for name in p.of_radar}
        if not shared and (apart := radar_differences(scene.radar, one.radar, fitted)):
            warnings.warn(
                f"{scene.name}: the radars of scene and raw data differ: {', '.join(apart)}; that of the raw data is "
                "used",
                SarmitsubaWarning,
                stacklevel=4,
            )
        looks.append(MeasuredLook.of(_traced_as(_seen_by(scene, one, fitted), one), one, parameters))
    if len(looks) > 1:
        _check_shared(looks)
    return tuple(looks)


def radar_differences(own: Radar, told: Radar, fitted: Iterable[str] = ()) -> list[str]:
    """How a scene's radar differs from that of raw data, one phrase each, scene first.

    ``fitted`` : fields that are fitted and may differ. The receive window, the noise and fields that only a focuser
    uses are not compared, nor motion within the pulse, which is an effect.
    """
    first, second = own.as_recorded().in_file_frame(), told.in_file_frame()
    found = [] if "track" in fitted else _track_differences(first, second)
    if _is_bistatic(first) != _is_bistatic(second):
        found.append("a separate receiver in one alone")
    waves, windows = (first.waveform, second.waveform), (first.window, second.window)
    found += _apart("bandwidth", [1e-6 * wave.bandwidth for wave in waves], " MHz")
    found += _apart("spacing of samples", [window.sample_spacing for window in windows], " m")
    antennas = first.antenna, second.antenna
    if antennas[0].pattern != antennas[1].pattern:
        found.append(f"patterns {antennas[0].pattern} and {antennas[1].pattern}")
    elif antennas[0].directive:
        found += _apart("beam in azimuth", np.degrees([a.azimuth_beamwidth for a in antennas]), " deg")
        found += _apart("beam in elevation", np.degrees([a.elevation_beamwidth for a in antennas]), " deg")
    if "transmit_power" not in fitted:
        constants = [radar.amplitude_constant**2 for radar in (first, second)]
        found += _apart("power with gains", db_from_power(constants), " dB")
    return found


def _track_differences(first: Radar, second: Radar) -> list[str]:
    """The same of tracks and looks alone."""
    lines = [radar.aim_point - radar.track.center_position for radar in (first, second)]
    angles = np.degrees([np.arccos(-line[2] / np.linalg.norm(line)) for line in lines])
    found = _apart("look angle", angles, " deg", 1e-4)
    if first.look_side != second.look_side:
        found.append(f"look sides {first.look_side} and {second.look_side}")
    tracks = first.track, second.track
    if tracks[0].n_pulses != tracks[1].n_pulses:
        found.append(f"pulses {tracks[0].n_pulses} and {tracks[1].n_pulses}")
    elif (away := float(np.abs(tracks[0].position - tracks[1].position).max())) > (
        SAME_TRACK * second.waveform.wavelength
    ):
        found.append(f"tracks up to {away:.3g} m apart")
    return found


def _apart(name: str, both: ArrayLike, unit: str, share: float = SAME_NUMBER) -> list[str]:
    """Phrase that gives both numbers where they differ by more than a share; else none."""
    one, other = np.asarray(both, dtype=np.float64).tolist()
    return (
        [f"{name} {one:.6g} and {other:.6g}{unit}"]
        if abs(one - other) > share * max(abs(one), abs(other))
        else []
    )


def _is_bistatic(radar: Radar) -> bool:
    return radar.receiver is not None and not radar.receives_itself


def _check_band(scene: Scene, data: RawData) -> None:
    """Refuse data of another centre frequency, as the materials are those of the scene's, or of other channels."""
    own, told = scene.radar, data.radar
    frequencies = own.waveform.center_frequency, told.waveform.center_frequency
    if abs(frequencies[0] - frequencies[1]) > SAME_CARRIER * frequencies[0]:
        raise DataError(
            f"{scene.name}: the centre frequencies of raw data and scene are {1e-9 * frequencies[1]:.6g} and "
            f"{1e-9 * frequencies[0]:.6g} GHz; give the scene the radar of the data"
        )
    if set(data.channels) != set(own.channels):
        raise DataError(
            f"{scene.name}: raw data of channels {', '.join(data.channels)} and a radar of {', '.join(own.channels)}; "
            "give the scene the polarisation of the data"
        )


def _seen_by(scene: Scene, data: RawData, fitted: Iterable[str]) -> Scene:
    """The scene under the radar that recorded raw data, with its image; ``fitted``: fields taken from the scene.

    Raises
    ------
    DataError : a track to be fitted has another number of pulses, or the receive window none of the scene's ranges
    """
    shift = data.radar.offset - scene.offset
    own, request = data.radar, data.request
    kept = moving_in_pulse(scene.radar) if own.receives_itself else scene.radar
    fields = {name: getattr(kept, name) for name in fitted if name != "window"}
    if fields and kept.track.n_pulses != own.track.n_pulses:
        raise DataError(
            f"{scene.name}: raw data of {own.track.n_pulses} pulses, and a radar to be fitted of "
            f"{kept.track.n_pulses}; give the scene the radar of the data: aperture, prf and n_pulses"
        )
    radar = replace(
        own.displaced(*[shift] * len(own.tracks)), aim_point=own.aim_point + shift, offset=scene.offset
    )
    if data.flown is not None:
        # the receiver is as far off its record as the transmitter
        error = data.flown.position - own.track.position
        flown = radar.displaced(*[error] * len(own.tracks))
        radar = replace(flown, track=replace(data.flown, position=flown.track.position), recorded=radar.track)
    radar = replace(radar, channels=scene.radar.channels, **fields)
    corners = np.array(list(product(*zip(*scene.geometry.bounds, strict=True))))
    ranges = np.array([radar.slant_range(corner) for corner in corners])
    start = radar.window.start_range
    if (ranges.max(axis=0) < start).all() or (ranges.min(axis=0) > start + radar.window.extent).all():
        raise DataError(
            f"{scene.name}: the receive window of the raw data begins at {start.min():.6g} m and holds none of the "
            f"scene's echoes, from {ranges.min():.6g} m; give the scene the place of the data"
        )
    if request is None:
        return replace(scene, radar=radar)
    return replace(scene, radar=radar, image=request.in_frame(scene.offset))


def _traced_as(scene: Scene, data: RawData) -> Scene:
    """The scene with the ray sets, the spacings of rays and pulses, and the seed of simulated raw data."""
    told, sampling, spacings = (
        found if isinstance(found := data.metadata.get(name), Mapping) else {}
        for name in ("settings", "sampling", "ray_spacing_settings")
    )
    found = {**{name: told[name] for name in OF_RAYS if name in told}, **spacings}
    for name in ("scatterer_cell", "key_pulse_interval"):
        if sampling.get(name) and found.get("method") != "raw":
            found[name] = sampling[name]
    own = {name: getattr(scene.settings, name) for name in found}
    found = {
        name: type(own[name])(value)
        for name, value in found.items()
        if isinstance(value, str) == isinstance(own[name], str)
    }
    subsets = any(layer.subset for layer in data.layers)
    return replace(scene, settings=replace(scene.settings, keep_subsets=subsets, **found))


def _check_shared(looks: Sequence[MeasuredLook]) -> None:
    """Refuse looks of different scenes, and parameters of a radar, which differ from look to look."""
    first = looks[0].model
    for parameter in first.parameters:
        if parameter.changed(first.scene, parameter.values(first.scene)).radar is not first.scene.radar:
            raise SceneError(
                f"fit: {parameter.label} belongs to the radar of one look, and there are {len(looks)} looks; fit it to "
                "the data of its look alone"
            )
    for look in looks[1:]:
        own = look.model
        if own.names != first.names or not np.allclose(own.start, first.start):
            raise SceneError(
                f"fit: the looks {first.scene.name} and {own.scene.name} differ in the start values of "
                f"{', '.join(first.names)}; give scenes that differ in the radar alone"
            )


def _planes(model: ForwardModel, data: RawData) -> C64:
    """Measured data (channels, pulses, samples), their layers of a channel summed."""
    name, radar = model.scene.name, model.scene.radar
    if data.domain != "compressed":
        raise DataError(
            f"{name}: raw data are {data.domain}; a fit takes range-compressed ones, as simulate() gives"
        )
    if data.data.shape[1:] != model.shape[1:]:
        raise DataError(
            f"{name}: raw data of {data.data.shape[1]} pulses of {data.data.shape[2]} samples, and their radar has "
            f"{model.shape[1]} of {model.shape[2]}; give raw data with the radar that recorded them"
        )
    out = np.zeros(model.shape, dtype=np.complex64)
    for plane, layer in zip(data.data, data.layers, strict=True):
        out[radar.channels.index(layer.channel)] += plane
    if not np.isfinite(out).all():
        n = int(np.count_nonzero(~np.isfinite(out)))
        raise DataError(
            f"{name}: {n} of {out.size} samples of the raw data are not finite; leave them out or repair them"
        )
    if not out.any():
        raise DataError(f"{name}: the raw data are zero: nothing can be fitted to them")
    return out
