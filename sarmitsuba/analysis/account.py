"""Account of an image: error by cause, seconds by stage, and the changes of settings that pay most."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from sarmitsuba.analysis.error_budget import (
    BOUND,
    LAW,
    MEASURED,
    NONE_DB,
    UNKNOWN,
    BudgetFacts,
    ErrorPart,
    bounces_left_out,
    effects_by_name,
    effects_db,
    error_budget,
    gridding_error_db,
    is_stated_by_law,
    likely_effects_db,
    number,
)
from sarmitsuba.core.constants import RAY_ERROR_ORDER
from sarmitsuba.core.units import db_from_amplitude, db_from_power, power_from_db
from sarmitsuba.signal.focusing.comparison import Alternative
from sarmitsuba.signal.image import SarImage

# change of the sum of the known errors, dB, up to which a coarser setting counts as no loss, and least gain of a finer
# one; energies of errors are themselves known to 1.5 dB (benchmarks/suite/error_bars.py)
VISIBLE_DB = 0.5
# share of the run's processor time that a coarser setting must save
WORTH = 0.1
# factor of finer and coarser ray spacings: four times and half the rays
FINER, COARSER = 0.5, math.sqrt(2.0)
# error energy of blocks is proportional to their length: 3 dB per halving (benchmarks/suite/key_pulse_interval.py)
BLOCK_ORDER = 1.0
# share of the tracing of rays, with a gridding kernel of 4 cells, that is proportional to the kernel's area
# (benchmarks/suite/gridding.py)
ADDING = 0.28
# share of the known error energy from which bounds make it a bound, and laws a law
_BOUNDED = 0.1
# dB by which the next number of bounces must lower their error
_DEEPER_DB = 3.0
# stages of which a simulation has one at least
_SIMULATING = frozenset(("trace", "points", "raster"))
# below this the errors of rays and blocks are mostly rounding, and their laws do not hold, dB; no sum below is worth a
# change
_LAWLESS_DB = -60.0
_WIDTHS = (2, 8)  # of gridding kernels, cells
_EFFECTS = "effects left out"


@dataclass(frozen=True)
class StageTime:
    """Time of a stage of a run.

    Parameters
    ----------
    elapsed : s
    processor : s, of all threads; NaN: not measured
    """

    elapsed: float
    processor: float = math.nan


@dataclass(frozen=True)
class Change:
    """Change of one setting, and its effect on error and time.

    Parameters
    ----------
    cause : of the error it changes
    options : of ``render`` or ``focus``
    error_db : of the cause, before and after
    total_db : of the sum of all known errors, before and after
    seconds : processor seconds more, below 0 fewer; NaN: not known
    known : kind of the cause's error before the change, see :class:`ErrorPart`; that after it is by a law
    likely_db : likely sum, before and after: a loose bound neither calls for a change nor hides a loss
    sum_kind : kind of the sum, by the parts of it that count
    left_out_db : likely error of the cause afterwards, of effects left out; NaN: as ``error_db``
    """

    cause: str
    options: str
    error_db: tuple[float, float]
    total_db: tuple[float, float]
    seconds: float
    known: str
    likely_db: tuple[float, float] = (math.nan, math.nan)
    sum_kind: str = MEASURED
    left_out_db: float = math.nan

    def __str__(self) -> str:
        """Text such as ``max_depth=3 (bounces left out -30 -> -45 dB, all known errors -29 -> -35 dB; law)``."""
        time = "time not known"
        if not math.isnan(self.seconds):
            time = f"about {abs(self.seconds):.2g} CPU s {'more' if self.seconds >= 0.0 else 'less'}"
        return (
            f"{self.options} ({self.cause} {_level(self.error_db[0])} -> {_level(self.error_db[1])} dB, "
            f"all known errors {_level(self.total_db[0])} -> {_level(self.total_db[1])} dB, {time}; law)"
        )

    def as_dict(self) -> dict[str, object]:
        """Values for JSON; None for no error and for an unknown time."""
        return {
            "cause": self.cause,
            "options": self.options,
            "error_db": [_finite(x) for x in self.error_db],
            "total_db": [_finite(x) for x in self.total_db],
            "processor_seconds": _finite(self.seconds),
            "known": self.known,
            "total_known": self.sum_kind,
            "likely_total_db": [_finite(x) for x in self.likely_db],
        }


@dataclass(frozen=True)
class Account:
    """Error by cause, time by stage, and the changes that pay.

    Parameters
    ----------
    parts : error by cause
    stages : time by stage; none of the simulation where the echoes were there before
    finer : change that lowers the likely sum of the known errors most; None where none lowers it, and the stated
        sum, by ``VISIBLE_DB``
    coarser : change that saves most time and raises that sum by less than ``VISIBLE_DB``; None where none saves
        ``WORTH`` of the time
    changes : all that were considered
    target_db : wanted error of a run that adds passes; NaN: none was
    """

    parts: tuple[ErrorPart, ...]
    stages: Mapping[str, StageTime]
    finer: Change | None
    coarser: Change | None
    changes: tuple[Change, ...] = ()
    target_db: float = math.nan

    @property
    def met(self) -> bool:
        """Whether there is a wanted error, and the likely sum of the known errors is at most that."""
        return likely_total_db(self.parts) <= self.target_db

    @property
    def total_db(self) -> float:
        """Sum of all known error energies relative to that of the image, dB; -inf: none is known."""
        return total_db(self.parts)

    @property
    def kind(self) -> str:
        """Kind of the sum: a law or a bound where these are a part of it that counts."""
        return _sum_kind(self.parts)

    @property
    def contradicted(self) -> tuple[ErrorPart, ...]:
        """Errors that were measured far above what a law foretold."""
        return tuple(part for part in self.parts if part.contradicts)

    @property
    def advice(self) -> tuple[str, str]:
        """The change that lowers the error most, and the one that saves most, as text."""
        finer = "no single setting lowers the known error visibly"
        loose = sum(_energy(part.error_db) for part in self.parts if not math.isnan(part.likely_db))
        if loose > 0.5 * _energy(self.total_db):
            finer += "; effects left out are only bounded, `explain --measure` measures them"
        if self.finer:
            again = _SIMULATING.isdisjoint(self.stages) and self.finer.cause != "focuser"
            finer = f"{'simulate again with ' * again}{self.finer}"
        if self.parts[0].known == UNKNOWN:
            finer += "; the error of the rays is not measured"
        nothing = (
            f"nothing coarser saves {100 * WORTH:.0f} % of the processor time for less than {VISIBLE_DB:g} dB"
        )
        if self.met:
            finer = f"not needed, the wanted {self.target_db:g} dB are met; to go on, {finer}"
        return f"to lower the error: {finer}", f"to save time: {self.coarser or nothing}"

    def as_dict(self) -> dict[str, object]:
        """Values for JSON, without the parts, which have their own entry."""
        return {
            "total_db": _finite(self.total_db),
            "known": self.kind,
            "stages": {
                name: {"seconds": round(t.elapsed, 4), "processor_seconds": _finite(t.processor, 4)}
                for name, t in self.stages.items()
            },
            "advice": list(self.advice),
            "finer": self.finer.as_dict() if self.finer else None,
            "coarser": self.coarser.as_dict() if self.coarser else None,
        }


def account(image: SarImage, stages: Mapping[str, StageTime], others: Iterable[Alternative] = ()) -> Account:
    """Account of a simulated image.

    Parameters
    ----------
    image : of :func:`sarmitsuba.focus` or :func:`sarmitsuba.render`, with its error bars
    stages : time of the run by stage; those of the simulation may be missing where the data were made before
    others : focusers in place of the one used

    Notes
    -----
    Laws: energy of the error of the rays as their number to the power 0.83, energy of the error of blocks as their
    length; bounces, effects and gridding from the run's statements. Time of tracing as the rays or blocks, a
    bounce more as the mean bounces (at most). Errors of different causes are independent and their energies add.
    Every law is checked by applying the change (tests/analysis/test_account.py).
    """
    parts, data = error_budget(image), BudgetFacts(image.metadata)
    by_name = {part.name: part for part in parts}
    spent = _Spent.of(data)
    changes = [
        *_rays(data, by_name["rays"], spent),
        *_bounces(data, by_name["bounces left out"], spent),
        *_blocks(data, by_name["blocks of pulses"], spent),
        *_gridding(data, by_name["gridding"], spent),
        *_effects(data, by_name[_EFFECTS], spent),
        *_focusers(by_name["focuser"], others, stages),
    ]
    weighed = [_add_total(change, parts) for change in changes]
    finer = [
        c for c in weighed if _LAWLESS_DB < c.likely_db[0] and _lowers(c.likely_db) and _lowers(c.total_db)
    ]
    needed = WORTH * sum(t.processor for t in stages.values() if not math.isnan(t.processor))
    coarser = [c for c in weighed if c.seconds < -needed and c.likely_db[1] < c.likely_db[0] + VISIBLE_DB]
    if _SIMULATING.isdisjoint(stages):  # echoes that are there already take no time
        coarser = [c for c in coarser if c.cause == "focuser"]
    return Account(
        parts,
        dict(stages),
        min(finer, key=lambda c: c.likely_db[1], default=None),
        min(coarser, key=lambda c: c.seconds, default=None),
        tuple(weighed),
        _target_db(data),
    )


def _lowers(level_db: tuple[float, float]) -> bool:
    """Whether an error falls visibly, from before to after."""
    return level_db[0] >= level_db[1] + VISIBLE_DB


def _target_db(data: BudgetFacts) -> float:
    """Wanted error of a run that adds passes, dB; NaN where none was."""
    wanted = number(data.part("refinement").get("target_error_db"))
    return wanted if wanted < 0.0 else math.nan


def total_db(parts: Iterable[ErrorPart]) -> float:
    """Sum of the known error energies, dB; -inf where none is known."""
    energy = sum(_energy(part.error_db) for part in parts if part.counts)
    return db_from_power(energy)


@dataclass(frozen=True)
class _Spent:
    """Processor seconds of tracing, of its part proportional to the rays, and of simulating; NaN: not measured."""

    tracing: float
    rays: float
    simulating: float

    @staticmethod
    def of(data: BudgetFacts) -> "_Spent":
        of_simulation = {name: number(s) for name, s in data.part("processor_seconds").items()}
        tracing = of_simulation.get("trace", math.nan)
        share = number(data.metadata.get("ray_share_of_tracing"))
        return _Spent(tracing, tracing * share, sum(of_simulation.values()) if of_simulation else math.nan)


def _energy(error_db: float) -> float:
    return 0.0 if math.isnan(error_db) else power_from_db(error_db)


def likely_total_db(parts: Iterable[ErrorPart]) -> float:
    """Likely sum of the known error energies, dB; -inf where none is known."""
    return total_db(replace(part, error_db=part.weight_db) for part in parts)


def _add_total(change: Change, parts: Iterable[ErrorPart]) -> Change:
    """Change with the sums of the errors, stated and likely."""
    before = tuple(part for part in parts if part.counts)
    after = tuple(
        replace(part, error_db=change.error_db[1], likely_db=change.left_out_db)
        if part.name == change.cause
        else part
        for part in before
    )
    return replace(
        change,
        total_db=(total_db(before), total_db(after)),
        likely_db=(likely_total_db(before), likely_total_db(after)),
        sum_kind=_sum_kind(before),
    )


def _sum_kind(parts: Iterable[ErrorPart]) -> str:
    """Kind of the sum of the known errors: that of the least certain part which counts in it."""
    known = [part for part in parts if part.counts]
    least = _BOUNDED * sum(_energy(part.error_db) for part in known)
    for kind in (LAW, BOUND):
        if sum(_energy(part.error_db) for part in known if part.known == kind) > least:
            return kind
    return MEASURED


def _change(part: ErrorPart, options: str, after_db: float, seconds: float) -> Change:
    return Change(part.name, options, (part.error_db, after_db), (math.nan, math.nan), seconds, part.known)


def _rays(data: BudgetFacts, part: ErrorPart, spent: _Spent) -> list[Change]:
    if not part.error_db > _LAWLESS_DB:
        return []
    if data.part("refinement"):  # passes: their number and density follow from the wanted error
        after = part.error_db + RAY_ERROR_ORDER * db_from_amplitude(FINER)
        return [_change(part, f"--target-error {math.floor(after)}", float(math.floor(after)), math.nan)]
    found = []
    spacings = {k: number(v) for k, v in data.part("ray_spacing_settings").items()}
    if not spacings or any(math.isnan(v) or v <= 0.0 for v in spacings.values()):
        return []
    # automatic blocks are as long as the error of the rays allows: they stay as they are
    interval = number(data.part("sampling").get("key_pulse_interval"))
    chosen = interval >= 2.0 and number(data.part("settings").get("key_pulse_interval")) == 0.0
    kept = f" {_path('key_pulse_interval', int(interval))}" if chosen else ""
    for factor in (FINER, COARSER):
        options = " ".join(f"-D sar_path.{k}={factor * v:.4g}" for k, v in spacings.items()) + kept
        after = part.error_db + RAY_ERROR_ORDER * db_from_amplitude(factor)
        found.append(_change(part, options, after, spent.rays * (factor**-2 - 1.0)))
    return found


def _bounces(data: BudgetFacts, part: ErrorPart, spent: _Spent) -> list[Change]:
    """Bounces more until they lower the error, and fewer where rays have them; each costs a mean bounce at most."""
    errors = bounces_left_out(data)
    depth = number(data.part("effects").get("max_depth"))
    if part.known == UNKNOWN or math.isnan(depth):
        return []
    statistics = data.part("statistics")
    bounces = number(statistics.get("hits")) / max(number(statistics.get("rays")), 1.0)
    found = []
    for other in range(1, len(errors)):
        if other > depth and errors[other] <= part.error_db - _DEEPER_DB:
            seconds = spent.rays * (other - depth) / depth
            found.append(_change(part, _path("max_depth", other), errors[other], seconds))
            break
    for other in range(
        1, min(int(depth), len(errors))
    ):  # a run without a pilot does not know what fewer leave out
        if other < bounces:
            seconds = -spent.rays * (1.0 - other / bounces)
            found.append(_change(part, _path("max_depth", other), errors[other], seconds))
    return found


def _blocks(data: BudgetFacts, part: ErrorPart, spent: _Spent) -> list[Change]:
    """Half the interval; twice it only where it was set: automatic blocks are as long as the track allows."""
    interval = number(data.part("sampling").get("key_pulse_interval"))
    if not part.error_db > _LAWLESS_DB or not interval >= 2.0:
        return []
    half = int(interval) // 2
    after = part.error_db + BLOCK_ORDER * db_from_power(half / interval)
    found = [_change(part, _path("key_pulse_interval", half), after, spent.tracing * (interval / half - 1.0))]
    if number(data.part("settings").get("key_pulse_interval")) > 0.0:
        after = part.error_db + BLOCK_ORDER * db_from_power(2.0)
        found.append(
            _change(part, _path("key_pulse_interval", 2 * int(interval)), after, -0.5 * spent.tracing)
        )
    return found


def _gridding(data: BudgetFacts, part: ErrorPart, spent: _Spent) -> list[Change]:
    width = number(data.part("settings").get("gridding_width"))
    if part.known == UNKNOWN or not math.isfinite(part.error_db) or not _WIDTHS[0] <= width <= _WIDTHS[1]:
        return []
    offset = part.error_db - gridding_error_db(int(width))  # of the share of the echoes that is shown
    now = 1.0 - ADDING + ADDING * (width / 4.0) ** 2
    return [
        _change(
            part,
            _path("gridding_width", other),
            offset + gridding_error_db(other),
            spent.rays * ADDING * ((other / 4.0) ** 2 - (width / 4.0) ** 2) / now,
        )
        for other in range(_WIDTHS[0], _WIDTHS[1] + 1)
        if other != int(width)
    ]


def _effects(data: BudgetFacts, part: ErrorPart, spent: _Spent) -> list[Change]:
    """Each effect that is off and whose error rays or images measured, on its own: a bound by a law calls for none.

    Only ``explain --measure`` measures the share of the time that one takes.
    """
    if part.known == UNKNOWN:
        return []
    found = []
    by_name = effects_by_name(data)
    for name, decision in by_name.items():
        if is_stated_by_law(decision):
            continue
        rest = {other: d for other, d in by_name.items() if other != name}
        seconds = spent.simulating * number(decision.get("cost"))
        change = _change(part, _path(name, "on"), effects_db(rest.values()), seconds)
        found.append(replace(change, left_out_db=likely_effects_db(rest.values())))
    return found


def _focusers(
    part: ErrorPart, others: Iterable[Alternative], stages: Mapping[str, StageTime]
) -> list[Change]:
    if part.known == UNKNOWN or "focus" not in stages:
        return []
    spent = stages["focus"].processor
    return [
        _change(part, f"--focuser {other.focuser}", other.error_db, spent * (other.time - 1.0))
        for other in others
    ]


def _path(name: str, value: object) -> str:
    return f"-D sar_path.{name}={value}"


def _level(error_db: float) -> str:
    return f"{error_db:.1f}" if error_db > NONE_DB and math.isfinite(error_db) else "none"


def _finite(value: float, digits: int = 2) -> float | None:
    return round(value, digits) if math.isfinite(value) else None
