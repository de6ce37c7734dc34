"""Data card of a data set: what was drawn, which physics was on, stated errors, seeds, versions, licence."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from sarmitsuba.apps.datasets.distributions import Fixed
from sarmitsuba.apps.datasets.recipe import PART_NAMES, Recipe
from sarmitsuba.apps.datasets.record import JsonTable
from sarmitsuba.machine.regular_files import read_text
from sarmitsuba.version import __version__

# bins of a histogram, width of its longest bar, notes and failures shown
_BINS, _BAR, _SHOWN = 10, 30, 12


def data_card(recipe: Recipe, labels: Sequence[JsonTable], mesh_parts: Mapping[str, str]) -> str:
    """Markdown text of the data card.

    Parameters
    ----------
    recipe : of the data set
    labels : facts of every sample, in order of their numbers
    mesh_parts : part of every mesh; empty where parts are by scene
    """
    title = recipe.text("dataset", "title") or recipe.path.stem
    parts = Counter(label["part"] for label in labels)
    tiles = len(recipe.corners)
    lines = [
        f"# {title}",
        "",
        f"{len(labels)} simulated images of {recipe.shape[0]} x {recipe.shape[1]} pixels"
        + (f", {tiles} tiles of {recipe.tile[0]} x {recipe.tile[1]} each" if tiles > 1 else "")
        + f", channels {', '.join(labels[0]['channels'])}; simulated by sarmitsuba {__version__}, not measured.",
        "",
        f"- recipe: `{recipe.path.name}`, SHA-256 {recipe.digest}",
        f"- seed: {recipe.seed}; sample n is made again by `python -m sarmitsuba dataset RECIPE --sample n -o OUT`",
        f"- licence: {recipe.text('dataset', 'licence') or 'not stated'}",
        "- parts by "
        + recipe.text("parts", "by")
        + ": "
        + ", ".join(f"{name} {parts.get(name, 0)}" for name in PART_NAMES),
        "",
    ]
    if mesh_parts:
        lines += ["## Meshes of the parts", ""]
        for part in PART_NAMES:
            names = [name for name, of in mesh_parts.items() if of == part]
            lines.append(f"- {part}: {', '.join(names) or 'none'}")
        lines.append("")
    lines += _shapes(labels) + _describe_draws(recipe, labels) + _physics(labels) + _errors(recipe, labels)
    lines += _failures(labels)
    lines += ["## Recipe", "", "```toml", read_text(recipe.path).rstrip(), "```", ""]
    return "\n".join(lines)


def _shapes(labels: Sequence[JsonTable]) -> list[str]:
    kinds = Counter(one["semantic_class"] for label in labels for one in label["objects"])
    if not kinds:
        return []
    lines = ["## Shapes", "", "| class | shapes |", "|---|---|"]
    lines += [f"| {kind} | {count} |" for kind, count in sorted(kinds.items())]
    angles = [one["aspect_deg"] for label in labels for one in label["objects"] if one["instance"]]
    return [*lines, "", *(_histogram("aspect_deg of shapes from meshes", angles) if angles else [])]


def _describe_draws(recipe: Recipe, labels: Sequence[JsonTable]) -> list[str]:
    lines = ["## Drawn values", ""]
    for name in labels[0]["facts"]:
        values = [label["facts"].get(name) for label in labels]
        section, _, key = name.partition(".")
        kind = recipe.sections[section].drawn.get(key) if section in recipe.sections else None
        if len(set(map(str, values))) == 1:
            if kind is not None and key in recipe.sections[section].given:
                lines += [f"- {name} = {values[0]}", ""]
            continue
        how = "" if kind is None or isinstance(kind, Fixed) else f" ({kind})"
        if any(isinstance(v, str | bool) for v in values):
            counts = Counter(str(v) for v in values)
            lines += [f"**{name}**{how}", "", "| value | samples |", "|---|---|"]
            lines += [f"| {value} | {count} |" for value, count in sorted(counts.items())] + [""]
        else:
            lines += _histogram(f"{name}{how}", [float(v) for v in values if v is not None])
    return lines


def _histogram(name: str, values: Sequence[float]) -> list[str]:
    """Table of counts, with the mean and the standard deviation."""
    spread = float(np.ptp(values))
    # values that differ by rounding alone have one bin
    distinct = len(set(values)) if spread > 1e-9 * float(np.abs(values).max()) else 1
    counts, edges = np.histogram(values, bins=min(_BINS, distinct))
    most = max(int(counts.max()), 1)
    lines = [
        f"**{name}**: mean {np.mean(values):.4g}, standard deviation {np.std(values):.4g}",
        "",
        "| from | to | samples | |",
        "|---|---|---|---|",
    ]
    for low, high, count in zip(edges[:-1], edges[1:], counts, strict=True):
        lines.append(f"| {low:.4g} | {high:.4g} | {count} | {'#' * round(_BAR * int(count) / most)} |")
    return [*lines, ""]


def _physics(labels: Sequence[JsonTable]) -> list[str]:
    """Effects and in how many samples each was on."""
    on = Counter[str]()
    known: dict[str, None] = {}
    for label in labels:
        for name, state in label["physics"].items():
            known[name] = None
            on[name] += _is_on(state)
    lines = ["## Physics", "", "| effect | samples with it on |", "|---|---|"]
    lines += [f"| {name} | {on[name]} of {len(labels)} |" for name in known]
    notes = Counter(note for label in labels for note in label["notes"])
    if notes:
        lines += ["", "Notes and warnings, with the number of samples:", ""]
        lines += [f"- {count}: {note}" for note, count in notes.most_common(_SHOWN)]
        if len(notes) > _SHOWN:
            lines.append(f"- {len(notes) - _SHOWN} more kinds of notes are not listed")
    return [*lines, ""]


def _is_on(state: object) -> bool:
    return bool(state.get("on")) if isinstance(state, Mapping) else bool(state)


def _errors(recipe: Recipe, labels: Sequence[JsonTable]) -> list[str]:
    lines = ["## Stated errors", ""]
    measured = [value for label in labels for value in label["sampling_error_db"].values()]
    every = recipe.whole("dataset", "error_every")
    if measured:
        lines += [
            f"Error by ray sampling, measured on every sample whose number is a multiple of {every} (energy of the "
            "error over that of the image, from a second image with other rays):",
            "",
            *_histogram("sampling error, dB", measured),
        ]
    else:
        lines += ["Error by ray sampling: not measured; `error_every` in [dataset] measures it.", ""]
    omitted = [value for label in labels for value in label["omitted_db"].values()]
    if omitted:
        lines += [
            "Error by theory: waves that metal sends and the program does not follow, energy over that of the image:",
            "",
            *_histogram("energy of omitted waves, dB", omitted),
        ]
    return lines


def _failures(labels: Sequence[JsonTable]) -> list[str]:
    reasons = Counter(reason for label in labels for reason in label["failures"])
    if not reasons:
        return ["## Failed draws", "", "None.", ""]
    lines = ["## Failed draws", "", f"{sum(reasons.values())} draws failed and were replaced:", ""]
    lines += [f"- {count}: {reason}" for reason, count in reasons.most_common(_SHOWN)]
    if len(reasons) > _SHOWN:
        lines.append(f"- {len(reasons) - _SHOWN} more kinds are not listed")
    return [*lines, ""]
