"""Error budget of an image by cause."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.echo.gridding import gridding_kernel
from sarmitsuba.image.sar_image import SarImage

MEASURED, AT_MOST, ESTIMATED, UNKNOWN = "measured", "at most", "estimated", "not measured"
THEORY = "theory of metal"
# energy of the echoes outside the image, dB, above which errors are stated relative to the image's energy
SHOWN_DB = 1.0
# rounding of echoes in complex64, relative to profiles of single pulses (benchmarks/suite/stated_errors.py)
_ROUNDING_DB = -115.0
# blocks below which their boundaries are so few that their scatter, which is added, makes the error a bound
_FEW_BLOCKS = 8
# dB that bounds of effects left out by a law, not by a pilot's rays, lie above the truth: 10 to 14 in drawn scenes
_LOOSE_DB = 10.0


@dataclass(frozen=True)
class ErrorPart:
    """Energy of one error relative to that of the image.

    Parameters
    ----------
    name : of the cause
    error_db : dB; NaN: unknown, -inf: no error
    known : ``measured``, ``at most``, ``estimated`` or ``not measured``
    why : source of the value, or reason for its absence
    likely_db : likely level of an error of which ``error_db`` is a loose bound, dB; NaN: as ``error_db``
    """

    name: str
    error_db: float
    known: str
    why: str = ""
    likely_db: float = math.nan

    @property
    def weight_db(self) -> float:
        """Level by which the error counts among the others, dB: the likely one; no sum of bounds."""
        return self.error_db if math.isnan(self.likely_db) else self.likely_db

    def __str__(self) -> str:
        """Text such as ``blocks of pulses -28.0 dB``."""
        if self.known == UNKNOWN or math.isnan(self.error_db):
            return f"{self.name} {UNKNOWN}"
        if self.error_db == -math.inf:
            return f"{self.name} none"
        bound = f"{self.known} " if self.known in (AT_MOST, ESTIMATED) else ""
        likely = ""
        if self.weight_db < self.error_db - 1.0:
            likely = (
                f" (likely {self.likely_db:.0f} dB)" if math.isfinite(self.likely_db) else " (likely none)"
            )
        return f"{self.name} {bound}{self.error_db:.1f} dB{likely}"

    @property
    def counts(self) -> bool:
        """Whether it is in the sum of the known errors, which settings change."""
        return self.known in (MEASURED, AT_MOST)

    def as_dict(self) -> dict[str, object]:
        """Values for JSON; None for an unknown error, or no error."""
        error, weight = (round(x, 2) if math.isfinite(x) else None for x in (self.error_db, self.likely_db))
        known = "none" if self.error_db == -math.inf else self.known
        likely = {} if math.isnan(self.likely_db) else {"likely_db": weight}
        return {"error_db": error, "known": known, **likely, "why": self.why}


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
    Effects left out are summed as independent energies; those without a bound are named. The error of the theory
    is the energy of waves that metal sends and the run does not follow, by the laws of
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


def _rays(data: BudgetFacts) -> ErrorPart:
    bars = [bar for bar in data.part("sampling_error").values() if isinstance(bar, Mapping)]
    errors = [number(bar.get("error_db")) for bar in bars]
    if not errors or any(math.isnan(x) for x in errors):
        if number(data.part("statistics").get("rays")) == 0.0 and data.metadata.get("method") != "raster":
            return ErrorPart("rays", -math.inf, MEASURED, "nothing is traced")
        return ErrorPart("rays", math.nan, UNKNOWN, "one set of rays")
    return ErrorPart("rays", max(errors), MEASURED, str(bars[0].get("source", "")))


def _bounces(data: BudgetFacts) -> ErrorPart:
    name = "bounces left out"
    decision = data.part("effects", "effects", "max_depth")
    depth = number(data.part("effects").get("max_depth"))
    if decision.get("on") is False and decision.get("error_is") == "none":
        return ErrorPart(name, -math.inf, MEASURED, str(decision.get("why", "")))
    left = bounces_left_out(data)
    if math.isnan(depth) or not 1 <= depth < len(left):
        return ErrorPart(name, math.nan, UNKNOWN, str(decision.get("why", "")))
    return _with_shown(
        data, ErrorPart(name, left[int(depth)], AT_MOST, "pilot trace, two standard errors included")
    )


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
    error = number(sampling.get("block_error_db"))
    if math.isnan(error):
        return ErrorPart(name, error, UNKNOWN, "where blocks meet, in the middle of the track")
    known = AT_MOST if number(data.part("statistics").get("key_pulses")) < _FEW_BLOCKS else MEASURED
    return _of_image(data, ErrorPart(name, error, known, "where blocks meet"))


def _of_image(data: BudgetFacts, part: ErrorPart) -> ErrorPart:
    """Error relative to the echoes' energy, converted to the image's energy as if all of it were within the image."""
    return _with_shown(data, replace(part, error_db=part.error_db - _shown_db(data)))


def _with_shown(data: BudgetFacts, part: ErrorPart) -> ErrorPart:
    """An error that is a bound because the image shows a part of the echoes' energy."""
    shown = _shown_db(data)
    if shown == 0.0:
        return part
    return replace(
        part, known=AT_MOST, why=f"{part.why}; the image shows {shown:.1f} dB of the energy of the echoes"
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
    return _of_image(data, ErrorPart("gridding", gridding_error_db(int(width)), AT_MOST, why))


def gridding_error_db(width: int) -> float:
    """Bound of the aliasing and rounding of gridding kernels of so many cells, relative to the echoes, dB."""
    # range, and range rate or azimuth
    kernel = 2.0 * 10.0 ** (0.1 * gridding_kernel(width).error_db)
    return 10.0 * math.log10(kernel + 10.0 ** (0.1 * _ROUNDING_DB))


def _focuser(data: BudgetFacts) -> ErrorPart:
    focus = data.part("focus")
    method = str(focus.get("method", ""))
    error = number(focus.get("stated_error_db"))
    if math.isnan(error):
        return ErrorPart("focuser", math.nan, UNKNOWN, f"{method} states none" if method else "")
    return _of_image(data, ErrorPart("focuser", error, AT_MOST, f"{method} against exact backprojection"))


def _effects(data: BudgetFacts) -> ErrorPart:
    """Error of effects that are off and would change the image."""
    if data.metadata.get("method") == "raster":
        why = "method raster has one bounce, no coherent return, no wires and no volumes"
        return ErrorPart("effects left out", math.nan, UNKNOWN, why)
    left_out = effects_by_name(data)
    unknown = [name for name, decision in left_out.items() if math.isnan(number(decision.get("error_db")))]
    if unknown:
        return ErrorPart("effects left out", math.nan, UNKNOWN, f"no bound of {', '.join(unknown)}")
    measured = all(decision.get("error_is") == "measured" for decision in left_out.values())
    known = MEASURED if measured else AT_MOST
    likely = math.nan if measured else likely_effects_db(left_out.values())
    return ErrorPart("effects left out", effects_db(left_out.values()), known, ", ".join(left_out), likely)


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
        share += repeated * 10.0 ** (0.1 * later[1] if len(later) > 1 else 0.0)
    return ErrorPart(THEORY, min(10.0 * math.log10(share), 0.0), ESTIMATED, why)


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
            energy += 10.0 ** (0.1 * (error - laws_lower_by * by_law(decision)))
    return 10.0 * math.log10(energy) if energy > 0.0 else -math.inf


def by_law(decision: Mapping[str, object]) -> bool:
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
