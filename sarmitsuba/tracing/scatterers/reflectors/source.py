"""Scatterers of extensions' kinds as a source, straight and over the ground, and their lobes over a block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import C64, F64, unit_rows
from sarmitsuba.core.errors import ExtensionError
from sarmitsuba.core.units import power_from_db
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.radar.polarisation import linear_parts
from sarmitsuba.scene.scatterers import SCATTERERS, ScattererTarget, targets_by_kind
from sarmitsuba.scene.scene import Scene
from sarmitsuba.tracing.kernel.device_arrays import device_array
from sarmitsuba.tracing.kernel.source import Part, PointSource, Scatterers, Source
from sarmitsuba.tracing.scatterers.reflectors.reflector import Reflector, Reflectors
from sarmitsuba.tracing.scatterers.sources import SOURCES, Expected, Site, SourceKind, most_bounces

if TYPE_CHECKING:
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.kernel.kernel import Accumulator, LaneArrays, TraceCounts
    from sarmitsuba.tracing.kernel.launch import LaunchGrid
    from sarmitsuba.tracing.kernel.state import Kernel

# lanes of one evaluation; bounds its memory
LANES = 500_000


def change_in_blocks(scene: Scene, kind: Reflector, targets: Sequence[ScattererTarget], length: int) -> float:
    r"""Largest relative energy of the change of a scatterer's amplitude from the key pulse to the others of a block.

    .. math:: \max_{d \le K/2} \frac{\sum_t |a(t + d) - a(t)|^2}{\sum_t |a(t)|^2}

    for blocks of K pulses, the largest over the scatterers that are not weaker than the strongest by the scene's
    tolerance. The sums are over the pulses, the recorded channels, and both legs straight and over level ground.

    Parameters
    ----------
    scene : radar, channels and tolerance
    kind, targets : scatterers of one kind
    length : of a block, K

    Raises
    ------
    ExtensionError
        An amplitude is not a finite number.

    Notes
    -----
    At the carrier. Ground that is not level is taken as level: its legs arrive a few degrees beside these.
    """
    lags = np.unique(np.geomspace(1, max(1, length // 2), 8).astype(int))
    change, power = [], []
    n_pulses = scene.radar.track.n_pulses
    step = max(1, LANES // (n_pulses * _ways(scene) * 4))
    for first in range(0, len(targets), step):
        here = targets[first : first + step]
        a = amplitudes_along(scene, kind, here)
        bad = np.argwhere(~np.isfinite(a).all(axis=2))
        if len(bad):
            raise ExtensionError(
                f'{scene.name}: kind of scatterer "{kind.name}": amplitude of "{here[bad[0, 0]].name}" is not a finite '
                f"number at pulse {bad[0, 1]}"
            )
        power.append(np.square(np.abs(a)).sum(axis=(1, 2)))
        change.append(
            np.max(
                [np.square(np.abs(a[:, d:] - a[:, : n_pulses - d])).sum(axis=(1, 2)) for d in lags], axis=0
            )
        )
    energy = np.concatenate(power)
    strong = energy > power_from_db(scene.settings.tolerance_db) * energy.max(initial=0.0)
    return float((np.concatenate(change)[strong] / energy[strong]).max(initial=0.0))


def amplitudes_along(scene: Scene, kind: Reflector, targets: Sequence[ScattererTarget]) -> C64:
    """Scattering amplitudes (n_targets, n_pulses, n) complex64, m: of every linear channel and pair of legs."""
    radar, n_pulses = scene.radar, scene.radar.track.n_pulses
    channels = dict.fromkeys(part for c in radar.channels for _, part in linear_parts(c))
    legs = []  # of each antenna: straight, and over the ground where there is any
    for track in radar.tracks:
        leg = track.position - np.array([target.position for target in targets])[:, None]
        to = unit_rows(leg)
        legs.append([to * [1.0, 1.0, sign] for sign in (1.0, -1.0)[: _ways(scene)]])
    sent, home, e, q = [], [], [], []
    for out in legs[0]:
        for back in legs[-1]:
            for channel in channels:
                sent.append(out)
                home.append(back)
                e.append(_basis(out)[channel[0]])
                q.append(_basis(back)[channel[1]])
    shape = (len(sent), len(targets), n_pulses)
    index = np.broadcast_to(np.arange(len(targets))[:, None], shape).astype(np.uint32).ravel()
    vectors = [
        mi.Vector3f(*(device_array(mi.Float, x.astype(np.float32)) for x in np.stack(v).reshape(-1, 3).T))
        for v in (sent, home, e, q)
    ]
    none = dr.zeros(mi.Vector3f, len(index))
    found = Reflectors(kind, targets, np.ones(len(targets))).scattered(
        dr.opaque(mi.Float, 2.0 * np.pi / radar.waveform.wavelength),
        device_array(mi.UInt32, index),
        (vectors[0], vectors[1]),
        (vectors[2], none),
        (vectors[3], none),
    )
    parts = [np.broadcast_to(np.asarray(x), index.size).reshape(shape) for x in (found.real, found.imag)]
    return np.moveaxis((parts[0] + 1j * parts[1]).astype(np.complex64), 0, 2)


def _ways(scene: Scene) -> int:
    return 2 if scene.geometry.n_faces else 1


def _basis(to_antenna: F64) -> dict[str, F64]:
    """Horizontal and vertical unit vectors for directions (..., 3) to an antenna."""
    h = np.cross(-to_antenna, [1e-9, 0.0, 1.0])  # not undefined straight up
    h = unit_rows(h)
    return {"H": h, "V": np.cross(h, -to_antenna)}


# s of a usual core to trace one, and bytes while they are laid out
TRACED, BYTES = 1e-6, 300


class OwnKinds(SourceKind):
    """Every kind that extensions register.

    Scatterers whose amplitude changes within a block of pulses by more than the tolerance, as in a lobe narrower than
    the block, are traced at every pulse: neither a block's key pulse nor a shorter block would tell the lobe.
    """

    name, rank = "reflectors", 15

    def make_source(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        targets = _own_targets(site.scene)
        if not targets:
            return None
        weights = site.shares(np.array([target.position for target in targets]))
        out = []
        for kind in _kinds(targets):
            mine = [i for i, target in enumerate(targets) if target.kind == kind.name and weights[i] > 1e-6]
            if mine:
                lit = [targets[i] for i in mine]
                scatterers = Reflectors(kind, lit, np.asarray(weights[mine]), np.array(mine))
                source = PointSource(scatterers, most_bounces(site.scene))
                out.append(_OfKind(source, _changes(site, kind, lit)))
        return _Several(tuple(out)) if out else None

    def estimate_cost(self, site: Site, sub_bands: int) -> Expected | None:
        """Each as a node of a wire, and as many as a block has pulses where it is traced at every pulse."""
        targets, traced = _own_targets(site.scene), 0
        for kind in _kinds(targets):
            mine = [target for target in targets if target.kind == kind.name]
            traced += len(mine) * (site.block if _changes(site, kind, mine) else 1)
        return Expected(traced, 0.0, TRACED, len(targets) * BYTES) if targets else None


def _own_targets(scene: Scene) -> list[ScattererTarget]:
    """Scatterers of extensions' kinds, in the order of the kinds."""
    each = (target for targets in targets_by_kind(scene.scatterers).values() for target in targets)
    return [target for target in each if isinstance(target, ScattererTarget)]


def _kinds(targets: Sequence[ScattererTarget]) -> list[Reflector]:
    """Kinds of these scatterers."""
    out = []
    for name in dict.fromkeys(target.kind for target in targets):
        kind = SCATTERERS[name]
        if not isinstance(kind, Reflector):
            raise ExtensionError(
                f"kind of scatterer {name!r} has no amplitude; derive it from sarmitsuba.extend.Reflector"
            )
        out.append(kind)
    return out


def _changes(site: Site, kind: Reflector, targets: Sequence[ScattererTarget]) -> bool:
    """Whether the amplitude of any changes within a block by more than the tolerance; refuses NaN and infinity."""
    allowed = float(power_from_db(site.scene.settings.tolerance_db))
    return change_in_blocks(site.scene, kind, targets, site.block) > allowed and site.block > 1


@dataclass(frozen=True, eq=False)
class _OfKind:
    """Scatterers of one kind, and whether they are traced at every pulse."""

    source: PointSource
    every_pulse: bool


@dataclass(frozen=True, eq=False)
class _PartOf(Part):
    """Part of one source of several."""

    source: int = 0


@dataclass(frozen=True, eq=False)
class _Several:
    """Several sources as one; see :class:`Source`."""

    each: tuple[_OfKind, ...]

    @property
    def unknown(self) -> frozenset[str]:
        """See :class:`PointSource`."""
        return frozenset().union(*(one.source.unknown for one in self.each))

    def parts(self, rays: Sequence[LaunchGrid], n_pulses: int) -> Sequence[Part]:
        return [
            _PartOf(part.grid, part.first, part.count, part.rays, of_kind.every_pulse, number)
            for number, of_kind in enumerate(self.each)
            for part in of_kind.source.parts(rays, n_pulses)
        ]

    def record(
        self, part: Part, kernel: Kernel, antenna: Antenna, accumulator: Accumulator
    ) -> tuple[TraceCounts, LaneArrays]:
        assert isinstance(part, _PartOf)
        return self.each[part.source].source.record(part, kernel, antenna, accumulator)

    def scatterers_of(self, part: Part) -> Scatterers:
        assert isinstance(part, _PartOf)
        return self.each[part.source].source.scatterers

    def at(self, wavelength: float) -> _Several:
        return _Several(tuple(replace(one, source=one.source.at(wavelength)) for one in self.each))


SOURCES.register(OwnKinds())
