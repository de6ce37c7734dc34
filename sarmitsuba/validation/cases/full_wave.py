"""Corner, box, cylinder beside a plate, all on ground, against exact solutions: where physical optics ends."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.validation import full_wave
from sarmitsuba.validation.cases import CASES, CaseEntry
from sarmitsuba.validation.comparison import Case, Comparison

F64 = NDArray[np.float64]
CO_POLAR = ((0, "HH"), (2, "VV"))
# dB below the peak of a cut: what is compared and what the plot shows
FLOOR, DRAWN = 3.0, 50.0
# largest deviation there, dB, HH and VV, and why it may be that large; shares are of the peak's field
TOLERANCE = {
    "corner": (1.5, 3.0, "waves off the rims and between the plates, a share of 0.2"),
    "box": (0.8, 0.8, "waves off the edges of walls of 4 to 6 wavelengths, a share of 0.1"),
    "cylinder": (
        3.5,
        3.0,
        "waves off rims, round the cylinder and between it and the plate, a share of 0.3 to 0.6",
    ),
}


def scene(name: str, quick: bool = False) -> Case:
    """One stored scene over all its cuts; quick takes one cut of each kind and every fourth direction."""
    given = full_wave.SCENES[name]
    cuts, every = (given.cuts[::2], 4) if quick else (given.cuts, 1)
    exact = {cut: full_wave.stored()[name][cut.name][::every] for cut in cuts}
    got = {cut: full_wave.simulated(name, cut, every) for cut in cuts}
    *tolerance, reason = TOLERANCE[name]
    comparisons = tuple(
        Comparison(
            f"{cut.name}, {channel}",
            cut.angle[::every],
            _db(exact[cut][:, i]),
            _db(got[cut][:, i]),
            tolerance=tolerance[i // 2],
            reason=reason,
            floor=FLOOR,
            drawn=DRAWN,
        )
        for cut in cuts
        if cut.glint
        for i, channel in CO_POLAR
    )
    return Case(
        name=f"full_wave_{name}",
        topic="full_wave",
        title=given.title,
        formula="electric field integral equation, Rao-Wilton-Glisson functions, mirror images for the ground",
        source="bempp-cl (Betcke and Scroggs 2021), stored in `sarmitsuba/validation/full_wave.json` with mesh, "
        f"convergence and effort; `{full_wave.REMAKE}` solves it again",
        x_label="angle (deg)",
        y_label="RCS (dB over a square wavelength)",
        comparisons=comparisons,
        note=f"Compared down to {FLOOR:g} dB below the peak of each cut, drawn down to {DRAWN:g} dB. "
        + _where_it_ends(np.concatenate([*exact.values()]), np.concatenate([*got.values()])),
    )


def _where_it_ends(exact: full_wave.C128, got: full_wave.C128) -> str:
    """The figures of all directions in words."""
    both = [full_wave.bands(exact[:, i], got[:, i]) for i, _ in CO_POLAR]
    text = [
        f"{h.near:g} to {h.far:g} dB below the peak: {h.mean_db:+.1f} / {v.mean_db:+.1f} dB "
        f"(rms {h.rms_db:.1f} / {v.rms_db:.1f})"
        for h, v in zip(*both, strict=True)
    ]
    cross = 10.0 * np.log10(np.sum(np.abs(got[:, 1]) ** 2) / np.sum(np.abs(exact[:, 1]) ** 2))
    return (
        "All cuts together, mean power over the exact one, HH / VV, and rms difference of the levels, by the exact "
        "level (which sorts filled nulls into the lowest class): "
        f"{'; '.join(text)}. Cross-polar power over all directions {cross:+.1f} dB."
    )


def _db(amplitude: full_wave.C128) -> F64:
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(amplitude), 1e-12)))


for _name in full_wave.SCENES:
    CASES.register(CaseEntry(f"full_wave_{_name}", "full_wave", partial(scene, _name)))

__all__ = ["scene"]
