"""One statement of the error of radar cross sections: sampling, bounces left out, and theory."""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F64, unit_rows
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.units import power_from_db
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.omitted_waves import SimulatedWaves
from sarmitsuba.effects.theory_error import (
    MOST_IMAGE_FACES,
    STRONG_DB,
    TheoryError,
    rms_db,
    state_error,
    theory_error,
    too_many,
    waves_left,
)
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.visible_faces import VisibleFaces
from sarmitsuba.simulation.planning.sampling.rays import POOR_DB, error_text, worst

# dB, total error above which a sweep is warned of
DOUBTFUL_DB = 3.0
# dB below the strongest channel's peak at which a channel is rounding
SILENT_DB = -80.0
# positions of the aperture that an image's account examines
APERTURE = 9
_REMEDIES = {
    "edges that are not simulated": "switch edge_diffraction on",
    "act as one": "describe the plate as a sheet without thickness",
}
_FULL_WAVE = "take solved currents for single levels"


@dataclass(frozen=True, eq=False)
class ErrorStatement:
    """Expected rms error, dB, of levels within ``STRONG_DB`` of the peak; infinite: not known.

    Parameters
    ----------
    power : (n_directions, n_channels) float64, m^2, simulated
    sampling, bounces : (n_channels,) float64, m^2, energy of the sampling error and of the bounces left out in a
        direction; NaN: not measured
    theory : waves that are not simulated, and its causes
    remedy : of the theory's error
    currents : how surface currents were solved, whose error by the mesh ``sampling`` then is; empty: by ray optics
    facets : (n_channels,) float64, m^2, energy of the error by facets of round metal in a direction; None: no such ones
    """

    power: F64
    sampling: F64
    bounces: F64
    theory: TheoryError
    remedy: str = _FULL_WAVE
    currents: str = ""
    facets: F64 | None = None

    @staticmethod
    def of(
        scene: Scene,
        flags: KernelFlags,
        directions: F64,
        amplitude: C128,
        sampling_db: tuple[float, ...],
        left_db: float,
    ) -> "ErrorStatement":
        """Statement on a sweep.

        Parameters
        ----------
        scene : the target, at its frequency
        flags : effects that were simulated
        directions : (n, 3) float64, unit vectors to the radar
        amplitude : (n, n_orders, n_channels) complex128, m
        sampling_db : of every channel, energy of the sampling error over that of the echoes, dB; NaN: not measured
        left_db : energy of the bounces left out over that of all, dB; -inf: none, NaN: not known

        Notes
        -----
        Energies of sampling and bounces left out are spread evenly over the directions.
        """
        waves = SimulatedWaves.of(scene, flags)
        wavelength = scene.radar.waveform.wavelength
        theory = theory_error(
            scene.geometry, scene.materials, directions, amplitude, flags.channels, wavelength, waves
        )
        power = np.square(np.abs(amplitude.sum(axis=1)))
        level = power_from_db(np.asarray(sampling_db, dtype=np.float64))
        left = 0.0 if math.isnan(left_db) else power_from_db(left_db)
        mean = power.mean(axis=0)
        return ErrorStatement(power, level * mean, left * mean, theory)

    def without_currents(self, why: str) -> "ErrorStatement":
        """The statement with the reason why currents are not solved as the remedy."""
        return replace(self, remedy=f"{_FULL_WAVE} ({why})")

    def of_currents(self, amplitude: C128, error: F64, text: str) -> "ErrorStatement":
        """Statement on solved currents in place of ray optics.

        Parameters
        ----------
        amplitude : (n, n_channels) complex128, m
        error : (n_channels,) float64, m^2, energy of the error by the mesh in a direction
        text : how they were solved
        """
        power = np.square(np.abs(amplitude))
        none = TheoryError(np.zeros_like(power), np.zeros(power.shape[1]), (), self.theory.counted)
        before = f"ray optics alone: {self._total_text}"
        return replace(
            self,
            power=power,
            sampling=error,
            bounces=np.zeros_like(error),
            theory=none,
            remedy="take a solver with a finer mesh",
            currents=f"{text}; {before}",
        )

    @cached_property
    def sampling_db(self) -> F64:
        """By the sampling with rays, (n_channels,)."""
        known = np.where(np.isnan(self.sampling) | self.silent, np.nan, 1.0)
        return np.asarray(known * rms_db(self._spread(self.sampling), self.power))

    @cached_property
    def bounces_db(self) -> F64:
        """By bounces left out, (n_channels,)."""
        return rms_db(self._spread(self.bounces), self.power)

    @cached_property
    def facets_db(self) -> F64:
        """By facets of round metal, (n_channels,)."""
        return rms_db(self._spread(self._facets), self.power)

    @property
    def _facets(self) -> F64:
        return np.zeros(self.power.shape[1]) if self.facets is None else self.facets

    @property
    def theory_db(self) -> F64:
        """By waves that are not simulated, (n_channels,); NaN without echoes."""
        return np.asarray(np.where(self.silent, np.nan, self.theory.rms_db))

    @cached_property
    def silent(self) -> NDArray[np.bool_]:
        """Channels (n_channels,) whose levels are rounding of the strongest channel's: they have no echo."""
        peak = self.power.max(axis=0, initial=0.0)
        most = peak.max(initial=0.0)
        return np.asarray((most > 0.0) & (peak <= power_from_db(SILENT_DB) * most))

    @cached_property
    def total_db(self) -> F64:
        """By all of them, (n_channels,); errors whose size is not measured are left out; NaN without echoes."""
        if self.theory.unknown:
            return self.theory.rms_db
        even = np.nan_to_num(self.sampling) + np.nan_to_num(self.bounces) + self._facets
        left = self._spread(even) + self.theory.missing
        return np.asarray(np.where(self.silent, np.nan, rms_db(left, self.power)))

    def over(self, rows: NDArray[np.bool_]) -> "ErrorStatement":
        """Statement on some of the directions, whose own peak counts; causes as before."""
        missing = self.theory.missing[rows]
        level = self.theory.rms_db if self.theory.unknown else rms_db(missing, self.power[rows])
        return replace(
            self, power=self.power[rows], theory=replace(self.theory, missing=missing, rms_db=level)
        )

    def _spread(self, energy: F64) -> F64:
        """Energy (n_channels,) at every direction; 0 where it is not known."""
        return np.broadcast_to(np.nan_to_num(energy), self.power.shape)

    @property
    def worst_db(self) -> float:
        """Largest total of the channels that count, dB."""
        return float(
            np.nan_to_num(self.total_db[self.theory.counted], nan=0.0, posinf=np.inf).max(initial=0.0)
        )

    @property
    def text(self) -> str:
        """Statement in one line."""
        counted = self.theory.counted
        parts = [
            f"sampling {_take_measured(self.sampling_db[counted])}",
            f"bounces left out {_take_measured(self.bounces_db[counted])}",
            f"{self.theory.text}, law",
        ]
        if self.currents:
            parts = [f"mesh {_take_measured(self.sampling_db[counted])}", self.currents]
        if self.facets is not None:
            # on the smooth surface, of which there are no solved currents
            level = (_law if self.currents else _take_measured)(self.facets_db[counted])
            parts.insert(1, f"facets of a round body {level}")
        return f"expected error (rms, down to {STRONG_DB:g} dB below the peak): {self._total_text}: {', '.join(parts)}"

    @property
    def _total_text(self) -> str:
        if self.theory.unknown:
            return "not known"
        if self.worst_db > DOUBTFUL_DB:
            return state_error(self.worst_db)
        return f"within {_level(self.total_db[self.theory.counted])}"

    @property
    def warning(self) -> str:
        """Warning with a remedy; empty where the total is low, or nothing is known that speaks against it."""
        if self.theory.unknown:
            return f"{self.theory.text}; {self.remedy}" if self.theory.doubtful else ""
        if self.worst_db <= DOUBTFUL_DB:
            return ""
        sampled = float(
            np.nan_to_num(np.fmax(self.sampling_db, self.bounces_db))[self.theory.counted].max(initial=0.0)
        )
        if self.currents:
            return f"levels are {state_error(self.worst_db)} by the mesh ({self.currents}); {self.remedy}"
        if self.facets is not None and float(self.facets_db[self.theory.counted].max()) > max(
            sampled, self.theory.worst_db
        ):
            return f"levels are {state_error(self.worst_db)} if facets stand for a round body; take more, or --smooth"
        if sampled > self.theory.worst_db:
            remedy = "set a smaller ray_spacing, or a higher max_depth"
        else:
            first = self.theory.causes[0].text if self.theory.causes else ""
            remedy = next((r for key, r in _REMEDIES.items() if key in first), self.remedy)
        return f"levels are {state_error(self.worst_db)} ({self.theory.text}); {remedy}"

    def as_dict(self, channels: tuple[str, ...]) -> dict[str, object]:
        """Values for JSON; None where they are not known."""
        return {
            "strong_part_db": STRONG_DB,
            **{
                name: {c: _finite(v) for c, v in zip(channels, values, strict=True)}
                for name, values in (
                    ("sampling_db", self.sampling_db),
                    ("bounces_left_out_db", self.bounces_db),
                    ("facets_db", self.facets_db),
                    ("theory_db", self.theory_db),
                    ("total_db", self.total_db),
                )
            },
            "causes": [{"cause": c.text, "rms_db": _finite(c.rms_db)} for c in self.theory.causes],
            "currents": self.currents,
            "witness": None if self.theory.witness is None else self.theory.witness.as_dict(),
            "text": self.text,
        }


def _level(values: F64) -> str:
    known = values[~np.isnan(values)]
    return (
        f"{max(float(known.max()), 0.0):.2g} dB"
        if known.size and np.isfinite(known).all()
        else "not measured"
    )


def _take_measured(values: F64) -> str:
    text = _level(values)
    return text if text == "not measured" else f"{text} (measured here)"


def _law(values: F64) -> str:
    return f"{_level(values)} (law)"


def _finite(value: float) -> float | None:
    return round(float(value), 3) if math.isfinite(value) else None


def image_theory(scene: Scene, flags: KernelFlags) -> dict[str, object]:
    """Energy of the waves that the metal of a scene sends and a run does not follow, for an image's metadata.

    Mean over the aperture of their RCS, m^2, which by Parseval's theorem is their energy in the image in resolution
    cells times m^2. Empty without metal and where nothing is coherent.

    Parameters
    ----------
    scene : as simulated
    flags : effects that are simulated

    Notes
    -----
    Ignores shadows, the beam, and waves of surfaces that are not metal. Where all is metal, ``repeated_share`` is the
    share of the energy of two bounces and more by which ray optics is wrong; beside other surfaces it is not known.
    """
    geometry, metallic = (
        scene.geometry,
        np.array([m.metallic and not m.invisible for m in scene.materials], dtype=bool),
    )
    if not geometry.n_faces or not metallic[geometry.face_material].any() or not flags.coherent:
        return {}
    visible = VisibleFaces.of(geometry, scene.materials)
    metal, corners = visible.metal, visible.corners[visible.metal]
    if too_many(corners, MOST_IMAGE_FACES):
        return {"why": f"{len(corners)} metal faces are too many to examine"}
    wavelength = scene.radar.waveform.wavelength
    place = scene.radar.track.position
    away = place[
        np.linspace(0, len(place) - 1, min(len(place), APERTURE)).round().astype(int)
    ] - corners.mean(axis=(0, 1))
    look = unit_rows(away)
    channels = scene.radar.channels
    waves = SimulatedWaves.of(scene, flags)
    left = waves_left(corners, np.ones(len(corners)), look, np.arange(len(look)), channels, wavelength, waves)
    by_cause = {left.text(name, wavelength): energy.mean(axis=0) for name, energy in left.energy.items()}
    total = np.sum(list(by_cause.values()), axis=0)
    largest = max(by_cause, key=lambda text: float(by_cause[text].max()))
    found: dict[str, object] = {
        "energy_m2": {c: float(v) for c, v in zip(channels, total, strict=True)},
        "why": largest,
    }
    if flags.multi_bounce and metal.all():
        # a face of two folds is one of three that meet, whose echoes bounce three times
        bounces = 3 if left.folds.n > 2 and not left.folds.plain.any() else 2
        found["repeated_share"] = float(left.repeated_share(wavelength, bounces)[-1])
    if left.witness is not None:
        found["fold"] = left.witness.as_dict()
        found["whole"] = bool(metal.all() and left.folds.n == 1 and left.faces.n == 2)
    return found


def theory_witness(theory: Mapping[str, object]) -> dict[str, object]:
    """Witness of the theory, of metal that is nothing but the measured fold; empty for others."""
    return {"theory": theory["fold"]} if theory.get("whole") else {}


def say_sampling_error(scene: Scene, spacing: float, errors: tuple[float, ...]) -> tuple[str, ...]:
    """Notes on a sampling error that is not low; a warning instead of a note where it is poor."""
    text = error_text(
        scene.name, worst(errors), spacing, scene.radar.waveform.wavelength, scene.settings.ray_spacing > 0.0
    )
    if worst(errors) > POOR_DB:
        warnings.warn(text, SarmitsubaWarning, stacklevel=3)
        return ()
    return (text,) if text else ()
