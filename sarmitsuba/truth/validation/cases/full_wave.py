"""Corner, box, cylinder beside a plate, all on ground, against exact solutions: where physical optics ends."""

from functools import partial

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.units import db_from_amplitude, db_from_power
from sarmitsuba.truth.validation import full_wave
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison

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
    given, stored = full_wave.SCENES[name], full_wave.read_stored()[name]
    cuts, every = (given.cuts[::2], 4) if quick else (given.cuts, 1)
    # the peak of HH is always among them
    pick = {cut: slice(int(np.abs(stored[cut.name][:, 0]).argmax()) % every, None, every) for cut in cuts}
    exact = {cut: stored[cut.name][pick[cut]] for cut in cuts}
    got = {cut: full_wave.simulate_amplitudes(name, cut, pick[cut]) for cut in cuts}
    *tolerance, reason = TOLERANCE[name]
    comparisons = tuple(
        Comparison(
            f"{cut.name}, {channel}",
            cut.angle[pick[cut]],
            _db(exact[cut][:, i]),
            _db(got[cut][:, i]),
            tolerance=tolerance[i // 2],
            reason=reason,
            # of the whole cut's peak
            floor=FLOOR - float(_db(stored[cut.name][:, i]).max() - _db(exact[cut][:, i]).max()),
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
        source="bempp-cl (Betcke and Scroggs 2021), stored in `sarmitsuba/truth/validation/full_wave.json` with mesh, "
        f"convergence and effort; `{full_wave.REMAKE}` solves it again",
        x_label="angle (deg)",
        y_label="RCS (dB over a square wavelength)",
        comparisons=comparisons,
        note=f"Compared down to {FLOOR:g} dB below the peak of each cut, drawn down to {DRAWN:g} dB. "
        + _where_it_ends(np.concatenate([*exact.values()]), np.concatenate([*got.values()])),
    )


def _where_it_ends(exact: C128, got: C128) -> str:
    """The figures of all directions in words."""
    text = []
    for i, channel in CO_POLAR:
        found = full_wave.bands(exact[:, i], got[:, i])
        text.append(
            f"{channel} "
            + ", ".join(
                f"{b.near:g} to {b.far:g} dB: {b.mean_db:+.1f} dB (rms {b.rms_db:.1f})" for b in found
            )
        )
    cross = db_from_power(np.sum(np.abs(got[:, 1]) ** 2) / np.sum(np.abs(exact[:, 1]) ** 2))
    return (
        "All cuts together, mean power over the exact one and rms difference of the levels, by how far the exact level "
        "lies below the peak (which sorts filled nulls into the lowest classes): "
        f"{'; '.join(text)}. Cross-polar power over all directions {cross:+.1f} dB."
    )


def _db(amplitude: C128) -> F64:
    return np.asarray(db_from_amplitude(np.maximum(np.abs(amplitude), 1e-12)))


for _name in full_wave.SCENES:
    CASES.register(CaseEntry(f"full_wave_{_name}", "full_wave", partial(scene, _name)))
