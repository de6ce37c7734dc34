"""Error budget of an image by cause."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.core.witness import Witness
from sarmitsuba.signal.gridding import gridding_kernel
from sarmitsuba.signal.image import SarImage

# kinds of a figure: found in this run on so many samples; never exceeded; foretold by a law that this run did not check
MEASURED, BOUND, LAW, UNKNOWN = "measured here", "bound", "law", "not measured"
THEORY = "theory of metal"
# energy of the echoes outside the image, dB, above which errors are stated relative to the image's energy
SHOWN_DB = 1.0
# rounding of echoes in complex64, relative to profiles of single pulses (benchmarks/suite/stated_errors.py)
_ROUNDING_DB = -115.0
# dB that bounds of effects left out by a law, not by a pilot's rays, lie above the truth: 10 to 14 in drawn scenes
_LOOSE_DB = 10.0


# errors below this are none: float32 images resolve no more
NONE_DB = -200.0


@dataclass(frozen=True)
class ErrorPart:
    """Energy of one error relative to that of the image.

    Parameters
    ----------
    name : of the cause
    error_db : dB; NaN: unknown, -inf: no error
    known : ``measured here``, ``bound``, ``law`` or ``not measured``
    why : source of the value, or reason for its absence
    likely_db : likely level of an error of which ``error_db`` is a loose bound, dB; NaN: as ``error_db``
    samples : number of values that were measured; 0: it is not known, or nothing was measured
    upper_db : level below which a measured error lies with 95 % probability, dB; NaN: not known
    law_db : prediction by a law of an error that was measured, dB; NaN: there is none
    """

    name: str
    error_db: float
    known: str
    why: str = ""
    likely_db: float = math.nan
    samples: int = 0
    upper_db: float = math.nan
    law_db: float = math.nan

    @property
    def weight_db(self) -> float:
        """Level by which the error counts among the others, dB: the likely one; no sum of bounds."""
        return self.error_db if math.isnan(self.likely_db) else self.likely_db

    @property
    def kind(self) -> str:
        """The kind with the number of samples, such as ``measured here (64)``."""
        return f"{self.known} ({self.samples})" if self.samples else self.known

    @property
    def contradicts(self) -> bool:
        """Whether the measured error lies far above a law's prediction."""
        return Witness(self.error_db, self.error_db, self.samples, self.law_db).contradicts

    def __str__(self) -> str:
        """Text such as ``blocks of pulses -28.0 dB, measured here (3)``."""
        return f"{self.name} {self.value}"

    @property
    def value(self) -> str:
        """Level and kind as text."""
        if self.known == UNKNOWN or math.isnan(self.error_db):
            return UNKNOWN
        if self.error_db <= NONE_DB:
            return (
                f"none found (95 %: {self.upper_db:.1f} dB), {self.kind}"
                if self.upper_db > NONE_DB
                else "none"
            )
        likely = f" (95 %: {self.upper_db:.1f} dB)" if self.upper_db > self.error_db + 1.0 else ""
        if self.weight_db < self.error_db - 1.0:
            likely = (
                f" (likely {self.likely_db:.0f} dB)" if math.isfinite(self.likely_db) else " (likely none)"
            )
        against = f", more than the law's {self.law_db:.1f} dB" if self.contradicts else ""
        return f"{self.error_db:.1f} dB{likely}, {self.kind}{against}"

    @property
    def counts(self) -> bool:
        """Whether it is in the sum of the known errors, which settings change."""
        return self.known != UNKNOWN and self.name != THEORY

    def as_dict(self) -> dict[str, object]:
        """Values for JSON; None for an unknown error, or no error."""
        levels = {"likely_db": self.likely_db, "upper_db": self.upper_db, "law_db": self.law_db}
        return {
            "error_db": _finite(self.error_db),
            "known": "none" if self.error_db == -math.inf else self.known,
            **({"samples": self.samples} if self.samples else {}),
            **{name: _finite(level) for name, level in levels.items() if not math.isnan(level)},
            **({"contradicts": True} if self.contradicts else {}),
            "why": self.why,
        }


def _finite(level: float) -> float | None:
    return round(level, 2) if math.isfinite(level) else None


def error_budget(image: SarImage) -> tuple[ErrorPart, ...]:
    """Error budget of a simulated image, from the metadata of run and focuser.

    Parameters
    ----------
    image : of :func:`sarmitsuba.focus` or :func:`sarmitsuba.render`, also read from a file

    Returns
    -------
    rays, bounces left out, blocks of pulses, gridding, focuser, effects left out, theory of metal. The first is the
    stated error of the image (worst channel), which excludes the others

    Notes
    -----
    A witness (:class:`sarmitsuba.core.witness.Witness`) in the metadata takes the place of a law, which stays as
    ``law_db``. Effects left out are summed as independent energies; those without a bound are named. The error of the
    theory is the energy of waves that metal sends and the run does not follow, by the laws of
    :mod:`sarmitsuba.effects.omitted_waves`; unknown for other surfaces, see docs/accuracy.md.
    """
    data = BudgetFacts(image.metadata)
    return (
        _rays(data),
        _bounces(data),
        _blocks(data),
        _gridding(data),
        _focuser(data),
        _effects(data),
        _theory(data, image),
    )


@dataclass(frozen=True)
class BudgetFacts:
    """Metadata, possibly from a file: values of unexpected types count as missing."""

    metadata: Mapping[str, object]

    def part(self, *names: str) -> Mapping[str, object]:
        """Nested mapping of these names; empty where there is none."""
        found: object = self.metadata
        for name in names:
            found = found.get(name) if isinstance(found, Mapping) else None
        return found if isinstance(found, Mapping) else {}


def number(value: object) -> float:
    """A number from a file; NaN for anything else."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _replace_by_witness(part: ErrorPart, facts: object) -> ErrorPart:
    """The part as a witness measured it, if there is one; its figure by a law, where it has one, as the prediction."""
    found = Witness.read(facts)
    if found is None:
        return part
    law = part.error_db if part.known == LAW else found.law_db
    return ErrorPart(
        part.name,
        found.error_db,
        MEASURED,
        found.reference,
        samples=found.samples,
        upper_db=found.upper_db,
        law_db=law,
    )


def _rays(data: BudgetFacts) -> ErrorPart:
    return _replace_by_witness(_rays_of_two_sets(data), data.part("witnesses").get("rays"))


def _rays_of_two_sets(data: BudgetFacts) -> ErrorPart:
    bars = [bar for bar in data.part("sampling_error").values() if isinstance(bar, Mapping)]
    errors = [number(bar.get("error_db")) for bar in bars]
    if not errors or any(math.isnan(x) for x in errors):
        if number(data.part("statistics").get("rays")) == 0.0 and data.metadata.get("method") != "raster":
            return ErrorPart("rays", -math.inf, MEASURED, "nothing is traced")
        return ErrorPart("rays", math.nan, UNKNOWN, "one set of rays")
    passes = number(data.part("refinement").get("passes"))
    sets = int(passes) if passes >= 2.0 else 2
    return ErrorPart("rays", max(errors), MEASURED, str(bars[0].get("source", "")), samples=sets)


def _bounces(data: BudgetFacts) -> ErrorPart:
    name = "bounces left out"
    decision = data.part("effects", "effects", "max_depth")
    depth = number(data.part("effects").get("max_depth"))
    if decision.get("on") is False and decision.get("error_is") == "none":
        return ErrorPart(name, -math.inf, BOUND, str(decision.get("why", "")))
    left = bounces_left_out(data)
    part = ErrorPart(name, math.nan, UNKNOWN, str(decision.get("why", "")))
    if not math.isnan(depth) and 1 <= depth < len(left):
        patches = number(data.part("effects", "pilot").get("patches"))
        part = ErrorPart(
            name,
            left[int(depth)],
            MEASURED,
            "patches of a pilot trace, two standard errors included",
            samples=0 if math.isnan(patches) else int(patches),
        )
    witness = data.part("witnesses").get("bounces")
    if Witness.read(witness) is not None:  # relative to the echoes
        return _refer_to_image(data, _replace_by_witness(part, witness))
    return _add_share_shown(data, part)


def bounces_left_out(data: BudgetFacts) -> list[float]:
    """Upper bound of the energy of bounces after 0, 1, ... over that of the image, dB; empty without a pilot."""
    upper = data.part("effects", "pilot").get("energy_from_order_upper_db")
    if not isinstance(upper, list):
        return []
    shown = _shown_db(data)
    # no energy has no level; what is left out is at most all
    return [-math.inf if left is None else min(number(left) - shown, 0.0) for left in upper]


def _blocks(data: BudgetFacts) -> ErrorPart:
    name, sampling = "blocks of pulses", data.part("sampling")
    if data.metadata.get("method") in ("image", "raster"):
        return ErrorPart(name, math.nan, UNKNOWN, "one look stands for all pulses")
    if number(sampling.get("key_pulse_interval")) <= 1.0 or not sampling:
        return ErrorPart(name, -math.inf, MEASURED, "every pulse is traced")
    error, witness = number(sampling.get("block_error_db")), data.part("witnesses").get("blocks")
    keys = number(data.part("statistics").get("key_pulses"))
    part = ErrorPart(name, math.nan, UNKNOWN, "where blocks meet, in the middle of the track")
    if not math.isnan(error):
        meeting = 0 if math.isnan(keys) else max(int(keys) - 1, 0)
        part = ErrorPart(name, error, MEASURED, "where blocks meet", samples=meeting)
    return _refer_to_image(data, _replace_by_witness(part, witness))


def _refer_to_image(data: BudgetFacts, part: ErrorPart) -> ErrorPart:
    """Error relative to the echoes' energy, converted to the image's energy as if all of it were within the image."""
    shown = _shown_db(data)
    levels = {name: getattr(part, name) - shown for name in ("error_db", "likely_db", "upper_db", "law_db")}
    return _add_share_shown(data, replace(part, **levels))


def _add_share_shown(data: BudgetFacts, part: ErrorPart) -> ErrorPart:
    """An error that is a bound because the image shows a part of the echoes' energy."""
    shown = _shown_db(data)
    if shown == 0.0 or part.known == UNKNOWN or part.error_db == -math.inf:
        return part
    return replace(
        part,
        known=LAW if part.known == LAW else BOUND,
        samples=0,
        why=f"{part.why}; the image shows {shown:.1f} dB of the energy of the echoes",
    )


def _shown_db(data: BudgetFacts) -> float:
    """Energy of the image over that of the echoes, dB, where it is so much less that errors are converted; else 0."""
    shown = number(data.part("focus").get("shown_energy_db"))
    return shown if shown < -SHOWN_DB else 0.0


def _gridding(data: BudgetFacts) -> ErrorPart:
    if data.metadata.get("method") == "raster" or number(data.part("statistics").get("rays")) == 0.0:
        return ErrorPart("gridding", -math.inf, MEASURED, "nothing is gridded")
    width = number(data.part("settings").get("gridding_width"))
    if not 1.0 <= width <= 8.0:
        return ErrorPart("gridding", math.nan, UNKNOWN)
    why = f"kernel of {width:g} cells, echoes at all frequencies used"
    return _refer_to_image(data, ErrorPart("gridding", gridding_error_db(int(width)), BOUND, why))


def gridding_error_db(width: int) -> float:
    """Bound of the aliasing and rounding of gridding kernels of so many cells, relative to the echoes, dB."""
    # range, and range rate or azimuth
    kernel = 2.0 * power_from_db(gridding_kernel(width).error_db)
    return db_from_power(kernel + power_from_db(_ROUNDING_DB))


def _focuser(data: BudgetFacts) -> ErrorPart:
    focus = data.part("focus")
    method = str(focus.get("method", ""))
    error = number(focus.get("stated_error_db"))
    part = ErrorPart("focuser", error, LAW, f"{method} against exact backprojection")
    if math.isnan(error):
        part = ErrorPart("focuser", math.nan, UNKNOWN, f"{method} states none" if method else "")
    if Witness.read(focus.get("witness")) is not None:  # of pixels: relative to the image
        return _replace_by_witness(part, focus["witness"])
    return _refer_to_image(data, part)


def _effects(data: BudgetFacts) -> ErrorPart:
    """Error of effects that are off and would change the image."""
    if data.metadata.get("method") == "raster":
        why = "method raster has one bounce, no coherent return, no wires and no volumes"
        return ErrorPart("effects left out", math.nan, UNKNOWN, why)
    left_out = effects_by_name(data)
    unknown = [name for name, decision in left_out.items() if math.isnan(number(decision.get("error_db")))]
    if unknown:
        return ErrorPart("effects left out", math.nan, UNKNOWN, f"no bound of {', '.join(unknown)}")
    measured = not any(is_stated_by_law(decision) for decision in left_out.values())
    likely = math.nan if measured else likely_effects_db(left_out.values())
    error = effects_db(left_out.values())
    if error == -math.inf:
        return ErrorPart("effects left out", error, BOUND, "none is off that would change the image")
    part = ErrorPart("effects left out", error, MEASURED if measured else LAW, ", ".join(left_out), likely)
    witness = data.part("witnesses").get("effects")
    if Witness.read(witness) is None:
        return part
    return _refer_to_image(data, _replace_by_witness(part, witness))  # relative to the echoes


def _theory(data: BudgetFacts, image: SarImage) -> ErrorPart:
    """Energy of the waves of metal that are not simulated, over that of the image, worst channel."""
    found = data.part("theory")
    energies = {c: number(v) for c, v in data.part("theory", "energy_m2").items()}
    why = str(found.get("why", "no metal; no other solver to compare with"))
    energy = {c: _energy(image, c) for c in image.channels if energies.get(c, math.nan) > 0.0}
    if min(energy.values(), default=0.0) <= 0.0 or len(energy) < len(image.channels):
        return ErrorPart(THEORY, math.nan, UNKNOWN, why)
    share = max(energies[c] / energy[c] for c in energy)
    repeated = number(found.get("repeated_share"))
    if not math.isnan(repeated):
        later = bounces_left_out(data)  # all of the image's energy without a pilot
        share += repeated * power_from_db(later[1] if len(later) > 1 else 0.0)
    part = ErrorPart(THEORY, min(db_from_power(share), 0.0), LAW, why)
    return _replace_by_witness(part, data.part("witnesses").get("theory"))


def _energy(image: SarImage, channel: str) -> float:
    """Energy of a channel, resolution cells times m^2."""
    grid = image.grid
    pixel = grid.azimuth_spacing * grid.range_spacing
    per_cell = image.sigma0(channel)
    if grid.kind == "slant":
        per_cell = per_cell / np.sin(image.incidence_angle)
    return float(per_cell.sum()) * pixel


def effects_db(decisions: Iterable[Mapping[str, object]], laws_lower_by: float = 0.0) -> float:
    """Sum of the error energies of effects that are off, dB; -inf for none, those without a bound count as none.

    Parameters
    ----------
    decisions : on the effects
    laws_lower_by : dB by which bounds that neither rays nor images measured are lowered
    """
    energy = 0.0
    for decision in decisions:
        error = number(decision.get("error_db"))
        if not math.isnan(error):
            energy += power_from_db(error - laws_lower_by * is_stated_by_law(decision))
    return db_from_power(energy)


def is_stated_by_law(decision: Mapping[str, object]) -> bool:
    """Whether an effect's error is a loose bound by a law, which neither rays nor images measured."""
    return decision.get("error_is") != "measured" and decision.get("source") != "pilot"


def likely_effects_db(decisions: Iterable[Mapping[str, object]]) -> float:
    """Likely error of effects that are off, dB: bounds by a law lie above it."""
    return effects_db(decisions, laws_lower_by=_LOOSE_DB)


def effects_by_name(data: BudgetFacts) -> dict[str, Mapping[str, object]]:
    """Decisions on the effects that are off and would change the image."""
    return {
        name: decision
        for name, decision in data.part("effects", "effects").items()
        if isinstance(decision, Mapping)
        and decision.get("on") is False
        and decision.get("error_is") != "none"
        and name not in ("max_depth", "key_pulse_interval")
    }
