"""Change of the scene's reflection over the radar's band."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.effects.bounds import angles_known, facet_bound, specular_db
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.scene.materials.diffuse import diffuse_tables, water_in
from sarmitsuba.scene.materials.fresnel import fresnel
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.sea_spectrum import angular_frequency
from sarmitsuba.scene.materials.slab import COSINES, slab_coefficients
from sarmitsuba.scene.scatterers import SCATTERERS, is_own
from sarmitsuba.signal.sub_bands import SubBands

# least number of traced frequencies (exact for changes linear in frequency), and the largest number
LEAST_SUB_BANDS, MOST_SUB_BANDS = 2, 16
# margin of the interpolation error of one return below the tolerance, dB: several add up
_BELOW_TOLERANCE_DB = 10.0
# level above the tolerance allowed for changes that are odd about the carrier: in quadrature to the peak, they affect
# neither level nor position to first order
_ODD_ABOVE_TOLERANCE_DB = 10.0
# phase difference of neighbouring rays up to which tubes count as areas, rad, and extent of the part of a facet of one
# ray about its phase centre, in tubes
_AREAS_UP_TO, _REACH = 2.0, 2.0
# (k s cos)^2 up to which a rough surface leaves anything coherent beside its diffuse return: -43 dB
_LEAVES = 2.5
# cosines of incidence and frequencies at which laws are compared
_COSINES, _FREQUENCIES = COSINES[::6], 257


@dataclass(frozen=True)
class _Law:
    """Frequency dependence of a kind of echo: name, factor (n, n_frequencies) complex, and its level in the image, dB.

    ``above_db``: level above the tolerance up to which it does not need the effect; a law with ``decides`` off counts
    only for the number of frequencies.
    """

    of: str
    values: C128
    share_db: float = 0.0
    above_db: float = 0.0
    decides: bool = True

    def error_db(self, band: SubBands, frequency: F64) -> float:
        """Rms error over the band of the interpolation from the traced frequencies, dB of the image."""
        at = band.frequencies
        index = (at - frequency[0]) / (frequency[1] - frequency[0])
        first = np.clip(np.floor(index).astype(int), 0, len(frequency) - 2)
        rest = index - first
        nodes = self.values[:, first] * (1.0 - rest) + self.values[:, first + 1] * rest
        error = nodes @ band.shares(frequency) - self.values
        ends = np.where((frequency == frequency[0]) | (frequency == frequency[-1]), 0.5, 1.0)  # trapezoids
        worst = float(np.sqrt((np.abs(error) ** 2 @ ends).max() / ends.sum()))
        return self.share_db + db_from_amplitude(max(worst, 1e-12))


class Wideband(Effect):
    r"""Frequency dependence; on where amplitudes (without the phase of the range) change over the band B.

    The error of using the carrier's amplitude at all frequencies is its rms change over the band. For a return
    proportional to f, such as the physical-optics return of an area, it is

    .. math:: \frac{B}{\sqrt{12} f_c}

    This, the return of a facet's corner (as 1/f), the coherent loss of a rough surface and diffuse laws (as a power of
    f through both ends of the band) are real factors that are odd about the carrier up to second order: in quadrature
    to the peak, they change neither level nor position, but side lobes and the nulls between them. These need the
    effect from 10 dB above the tolerance on (by default from B / f_c = 0.11 on). So does the drift of water's Bragg
    waves, which moves random scatterers by a fiftieth of a range cell at that level.

    Reflection coefficients of half spaces and slabs, and transmission through slabs, are compared with those at the
    carrier, relative to the incident wave. They need the effect from the tolerance on. The number of frequencies is
    such that the error of each is 10 dB below the tolerance.
    """

    name = "wideband"
    title = "change of scattering over the band"
    documentation = "amplitudes and materials at several frequencies of the band; off: the carrier's for all"
    off_when = "over the band no material changes by more than the tolerance, and B / f_c is below 0.11"
    off_means = "the carrier's amplitudes, permittivities and slabs at all frequencies"
    rank = 132

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        method = context.scene.settings.method
        if method == "raster":
            return Assessment(False, "method raster uses the level at the carrier", -np.inf)
        found, (count, whose) = self._of_materials(context, decided), _ask_extensions(context)
        if count <= (found.value or 1):
            return found
        wave = context.scene.radar.waveform
        # two frequencies serve amplitudes up to the square of the frequency; more serve what has no such bound
        change = 2.0 * wave.bandwidth / (np.sqrt(12.0) * wave.center_frequency)
        error = db_from_amplitude(change) if count == LEAST_SUB_BANDS else 0.0
        if error <= context.tolerance_db:
            return replace(found, error_db=max(found.error_db, error))
        why = f"{_wish_of(whose, count)} (without it, {found.why})"
        return Assessment(True, why, error, count, note=found.note)

    def _of_materials(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """Number of frequencies that materials, facets and slabs need."""
        if not context.scene.traced:
            return Assessment(False, "ideal points are the same at all frequencies", -np.inf)
        wave = context.scene.radar.waveform
        ends = np.linspace(-0.5, 0.5, _FREQUENCIES) * wave.bandwidth + wave.center_frequency
        relative = f"B / fc = {wave.bandwidth / wave.center_frequency:.2g}"

        def worst(count: int, frequency: F64, laws: list[_Law]) -> tuple[float, str]:
            band = SubBands(wave.center_frequency, wave.bandwidth, count)
            return max(((law.error_db(band, frequency), law.of) for law in laws), default=(-np.inf, ""))

        def against_carrier(frequency: F64, laws: list[_Law]) -> tuple[bool, float, str]:
            """Whether the effect is needed, the largest error without it, and the deciding law."""
            band = SubBands(wave.center_frequency, wave.bandwidth, 1)
            every = [(law.error_db(band, frequency), law) for law in laws]
            errors = [(x, law) for x, law in every if law.decides]
            calling = [(x, law) for x, law in errors if x > context.tolerance_db + law.above_db]
            if not errors:
                return False, -np.inf, "nothing changes over the band"
            error, law = max(calling or errors, key=lambda pair: pair[0])
            change = f"{law.of} changes by {error:.0f} dB over the band"
            if not calling and error > context.tolerance_db:
                most = context.tolerance_db + law.above_db
                change += f", in quadrature to the peak: up to {most:g} dB only side lobes change"
            return bool(calling), max(x for x, _ in every), change

        few = ends[:: (_FREQUENCIES - 1) // 8]
        needed, error, change = against_carrier(few, list(_laws(few, context, decided)))
        wanted = context.scene.settings.effects.get(self.name, "auto") == "on"
        if not (needed or wanted):
            return Assessment(False, f"{relative}: {change}", error)
        laws = list(_laws(ends, context, decided))
        needed, error, change = against_carrier(ends, laws)
        if not (needed or wanted):
            return Assessment(False, f"{relative}: {change}", error)
        count, left = LEAST_SUB_BANDS, worst(LEAST_SUB_BANDS, ends, laws)
        while left[0] > context.tolerance_db - _BELOW_TOLERANCE_DB and count < MOST_SUB_BANDS:
            count += 1
            left = worst(count, ends, laws)
        why, note = f"{relative}: {change}; {count} frequencies leave {left[0]:.0f} dB", ""
        if left[0] > context.tolerance_db:
            note = (
                f"{context.scene.name}: wideband: {count} frequencies, the most there are, leave {left[0]:.0f} dB of "
                f"{left[1]}, above tolerance_db = {context.tolerance_db:g}; narrow the band or make slabs thinner"
            )
        return Assessment(True, why, error, count, note=note)


def _ask_extensions(context: SceneContext) -> tuple[int, str]:
    """Frequencies that scatterers and effects of extensions ask for, and the name of the one that asks for most."""
    switches = context.scene.settings.effects
    own = [target.kind for target in context.scene.scatterers if is_own(target)]
    kinds = {name: SCATTERERS[name].frequencies for name in own if switches.get("own_scatterers") != "off"}
    asked = kinds | {e.name: e.frequencies for e in EFFECTS if switches.get(e.name) != "off"}
    name = max(asked, key=lambda key: asked[key])
    return asked[name], name


def _wish_of(name: str, count: int) -> str:
    """Why an effect or kind of scatterer needs so many frequencies: its own number, or the default of kinds."""
    if name in SCATTERERS and not SCATTERERS[name].states_frequencies:
        return f"{name} does not set `frequencies`; the default {count} is used"
    return f"{name} asks for {count} frequencies"


def _laws(frequency: F64, context: SceneContext, decided: Mapping[str, Decision]) -> Iterator[_Law]:
    """Frequency dependences of the scene's returns, of the effects that are on."""
    wave = context.scene.radar.waveform
    relative = (frequency / wave.center_frequency)[None].astype(np.complex128)
    if decided["coherent"].on:
        share = _coherent_db(context)
        yield _Law("the return of an area, as f,", relative, share, _ODD_ABOVE_TOLERANCE_DB)
        if decided["tube_phase"].on:  # the return of a facet's side is independent of frequency
            yield _Law(
                "the return of a facet's corner, as 1/f,", 1.0 / relative, share, _ODD_ABOVE_TOLERANCE_DB
            )
            if context.scene.settings.method != "raw" and context.sampling is not None:
                reach = _REACH * min(_phase_over_tube(context, context.sampling.ray_spacing), _AREAS_UP_TO)
                turning = relative * np.exp(1j * reach * (relative - 1.0))
                yield _Law("the phase over a part of a facet", turning, share, decides=False)
    mirrors = decided["coherent"].on or decided["max_depth"].on or context.scene.has_sources
    for material in context.unlike_materials:
        if decided["fresnel"].on and mirrors and not material.pec:
            yield from _reflection(material, frequency, context, slab=decided["slabs"].on)
        if decided["roughness"].on and mirrors and material.rms_height > 0.0:
            loss = np.exp(-2.0 * np.square(context.wavenumber * material.rms_height * relative))
            yield _Law(f"the coherent loss of {material.name}", loss, above_db=_ODD_ABOVE_TOLERANCE_DB)
            steepest = np.square(context.wavenumber * material.rms_height) * _steepest(context)
            # of what the surface leaves, where a pilot knows the coherent part of the image
            if context.pilot is not None and steepest <= _LEAVES:
                left = np.exp(-2.0 * steepest * (np.square(relative) - 1.0))
                yield _Law(
                    f"the coherent loss of {material.name}", left, _coherent_db(context), decides=False
                )
            if decided["coherent"].on:
                left = np.exp(
                    -2.0 * np.square(context.wavenumber * material.rms_height) * (np.square(relative) - 1.0)
                )
                share = _specular_db(context, material.rms_height)
                what = f"the specular return of {material.name}"
                if share > context.tolerance_db:
                    yield _Law(what, left, share, _ODD_ABOVE_TOLERANCE_DB)
        if decided["diffuse"].on and material.scatters:
            level = _diffuse(material, frequency, relative)  # a power of f: odd about the carrier as well
            yield _Law(f"the diffuse return of {material.name}", level, above_db=_ODD_ABOVE_TOLERANCE_DB)
    if decided["diffuse"].on:
        yield from _bragg_waves(frequency, context)


def _bragg_waves(frequency: F64, context: SceneContext) -> Iterator[_Law]:
    r"""Drift of water's Bragg waves, :math:`e^{j t (\omega(K) - \omega(K_c) f / f_c)}` at the rms time t of the track.

    Every frequency meets the wave of its own wavenumber :math:`K = 2 k \sin\theta`, which is not as fast as the
    carrier's.
    """
    scene = context.scene
    wave = scene.radar.waveform
    still = scene.settings.effects.get("water_motion") == "off"
    if still or not water_in(context.materials, wave.wavelength, scene.settings.seed):
        return
    time = float(np.sqrt(np.mean(np.square(scene.radar.track.time))))
    sines = np.sqrt(1.0 - np.square(np.clip(context.incidence_cosine, 0.0, 1.0)))[:, None]
    relative = frequency / wave.center_frequency
    short = 2.0 * context.wavenumber * sines
    turn = angular_frequency(short * relative) - angular_frequency(short) * relative
    yield _Law("the drift of Bragg waves", np.exp(1j * time * turn), above_db=_ODD_ABOVE_TOLERANCE_DB)


def _steepest(context: SceneContext) -> float:
    """Square of the cosine of incidence at a level or an upright face, whichever is larger."""
    middle = float(np.clip(np.mean(context.incidence_cosine), 0.0, 1.0)) ** 2
    return max(middle, 1.0 - middle)


def _coherent_db(context: SceneContext) -> float:
    """Coherent share of the image's energy, or its strongest cell relative to the limit for single cells, dB; <= 0."""
    pilot = context.pilot
    if pilot is None or pilot.total == 0.0:
        return 0.0
    cell = pilot.cell_db(0, 1) + context.tolerance_db - pilot.cell_limit_db(context.tolerance_db)
    return min(max(pilot.energy_db(0, 1, upper=True), cell), 0.0)


def _specular_db(context: SceneContext, height: float) -> float:
    """Share of the image's energy that faces of at least an rms height (m) may return specularly, dB; <= 0.

    -inf where no angle of a face is known: the coherent loss relative to the incident wave then decides alone.
    """
    if context.sampling is None or not angles_known(context):
        return -np.inf
    faces = facet_bound(context, least_height=height)
    if context.pilot is not None and context.pilot.clutter > 0.0:
        return min(0.0, specular_db(context, context.pilot, faces))
    return min(0.0, faces.specular_over_own_clutter_db)


def _phase_over_tube(context: SceneContext, spacing: float) -> float:
    """Phase difference of neighbouring rays on the most oblique face, rad, at the carrier; ``spacing``: of rays, m."""
    cosine = max(context.incidence_cosine[0], 0.05)
    return context.wavenumber * spacing * max(1.0, float(np.sqrt(1.0 - cosine**2)) / cosine)


def _reflection(material: Material, frequency: F64, context: SceneContext, *, slab: bool) -> Iterator[_Law]:
    """Reflection of a dielectric, and two-way transmission of a slab, relative to the incident wave."""
    thick = slab and material.thickness > 0.0
    if material.dispersion is None and not thick:
        return
    at = [material.at_frequency(float(f)) for f in frequency]
    if not thick:
        waves = [fresnel(_COSINES, m.permittivity) for m in at]
        yield _Law(f"the reflection of {material.name}", np.concatenate(np.moveaxis(np.array(waves), 0, -1)))
        return
    slabs = [
        slab_coefficients(m, SPEED_OF_LIGHT / float(f), _COSINES) for m, f in zip(at, frequency, strict=True)
    ]
    reflected = np.array([[s.r_te, s.r_tm] for s in slabs])
    yield _Law(f"the reflection of {material.name}", np.concatenate(np.moveaxis(reflected, 0, -1)))
    if material in context.seen_through:
        both_legs = np.concatenate(np.moveaxis(np.array([[s.t_te, s.t_tm] for s in slabs]), 0, -1)) ** 2
        # the echo moves by the delay at the carrier
        middle = len(frequency) // 2
        turn = np.angle(both_legs[:, middle + 1] * both_legs[:, middle - 1].conj())
        slope = turn / (frequency[middle + 1] - frequency[middle - 1])
        both_legs = both_legs * np.exp(-1j * slope[:, None] * (frequency - frequency[middle]))
        yield _Law(f"the transmission of {material.name}", both_legs)


def _diffuse(material: Material, frequency: F64, relative: C128) -> C128:
    """Amplitude of a diffuse law relative to the carrier, as a power of f through both ends of the band."""
    first, last = (
        diffuse_tables(material.at_frequency(float(f)), SPEED_OF_LIGHT / float(f), 7)
        for f in frequency[[0, -1]]
    )
    levels = [
        (a[1:-1], b[1:-1])
        for a, b in ((first.amplitude_h, last.amplitude_h), (first.amplitude_v, last.amplitude_v))
    ]
    low, high = (np.concatenate(side) for side in zip(*levels, strict=True))
    seen = (low > 0.0) & (high > 0.0)
    if not seen.any():
        return np.ones_like(relative)
    powers = np.log(high[seen] / low[seen]) / np.log(frequency[-1] / frequency[0])
    return np.asarray(relative ** powers[np.abs(powers).argmax()])


EFFECTS.register(Wideband())
