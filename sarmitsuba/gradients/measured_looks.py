"""Looks of a fit: measured raw data, each with the model of the scene that its radar sees."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sarmitsuba.arrays import C64
from sarmitsuba.echo.noise import noise_power
from sarmitsuba.echo.raw_data import RawData
from sarmitsuba.errors import DataError, SceneError
from sarmitsuba.gradients.forward_model import ForwardModel
from sarmitsuba.gradients.jacobian import Parameters, parameters_of
from sarmitsuba.gradients.least_squares import Samples
from sarmitsuba.scene.scene import Scene, SceneLike

# largest relative difference of the centre frequencies of data and scene
SAME_CARRIER = 1e-6
# and of the spacings of their samples
SAME_SPACING = 1e-9
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
    """Measured raw data of one radar with the model of what it sees.

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

    Receive windows are those of the data: an automatic one follows the heights and the track of the scene, and those of
    the measured scene are other ones.

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
    if len(loaded) == 1 and len(measured) > 1:
        loaded = [_seen_by(loaded[0], one) for one in measured]
    if len(loaded) != len(measured):
        raise SceneError(
            f"fit: {len(loaded)} scenes and {len(measured)} raw data; give a scene for each, or one for all"
        )
    looks = tuple(
        MeasuredLook.of(_received_as(scene, one), one, parameters)
        for scene, one in zip(loaded, measured, strict=True)
    )
    if len(looks) > 1:
        _check_shared(looks)
    return looks


def _seen_by(scene: Scene, data: RawData) -> Scene:
    """The scene under the radar that recorded raw data, with its image."""
    shift = data.radar.offset - scene.offset
    own, request = data.radar, data.request

    radar = replace(
        own.displaced(*[shift] * len(own.tracks)), aim_point=own.aim_point + shift, offset=scene.offset
    )
    if data.flown is not None:
        # the receiver is as far off its record as the transmitter
        error = data.flown.position - own.track.position
        flown = radar.displaced(*[error] * len(own.tracks))
        radar = replace(flown, track=replace(data.flown, position=flown.track.position), recorded=radar.track)
    if request is None:
        return replace(scene, radar=radar)
    return replace(scene, radar=radar, image=request.in_frame(scene.offset))


def _received_as(scene: Scene, data: RawData) -> Scene:
    """The scene with the receive window of raw data that have as many pulses, of the same sample spacing."""
    own, other = scene.radar.window, data.radar.window
    if len(own.start_range) != len(other.start_range):
        return scene
    if abs(own.sample_spacing - other.sample_spacing) > SAME_SPACING * own.sample_spacing:
        return scene
    gap = np.maximum(
        other.start_range - own.start_range - own.extent, own.start_range - other.start_range - other.extent
    )
    if gap.max() >= 0.0:
        raise DataError(
            f"{scene.name}: the receive window of the raw data begins up to "
            f"{float(np.abs(other.start_range - own.start_range).max()):.3g} m from the scene's and holds none of its "
            "echoes; give the scene the place and the radar of the data"
        )
    return replace(scene, radar=replace(scene.radar, window=other))


def _check_shared(looks: Sequence[MeasuredLook]) -> None:
    """Refuse looks of different scenes, and parameters of a radar, of which each look has its own."""
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
    if set(data.channels) != set(radar.channels):
        raise DataError(
            f"{name}: raw data of channels {', '.join(data.channels)} and a radar of {', '.join(radar.channels)}; "
            "give the scene the polarisation of the data"
        )
    if data.data.shape[1:] != model.shape[1:]:
        spacing, step = data.radar.window.sample_spacing, radar.window.sample_spacing
        raise DataError(
            f"{name}: raw data of {data.data.shape[1]} pulses of {data.data.shape[2]} samples {spacing:.6g} m apart, "
            f"and a radar of {model.shape[1]} of {model.shape[2]} samples {step:.6g} m apart; give the scene the radar "
            "of the data: bandwidth, aperture, prf and n_pulses"
        )
    own, other = radar.waveform.center_frequency, data.radar.waveform.center_frequency
    if abs(own - other) > SAME_CARRIER * own:
        raise DataError(
            f"{name}: the centre frequencies of raw data and scene are {1e-9 * other:.6g} and {1e-9 * own:.6g} GHz; "
            "give the scene the radar of the data"
        )
    if not np.array_equal(data.radar.window.start_range, radar.window.start_range):
        raise DataError(
            f"{name}: samples of raw data and scene are {data.radar.window.sample_spacing:.9g} and "
            f"{radar.window.sample_spacing:.9g} m apart; give the scene the radar of the data"
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
