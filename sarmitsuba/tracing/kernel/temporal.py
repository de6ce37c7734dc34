"""Temporal decorrelation: random numbers of diffuse scatterers at a given time after the first pass.

Nothing is stored between passes. Every run computes the scatterer's numbers from its key, its material and the days
since the first pass, so that any two runs of one scene agree in all scatterers that did not change between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel.speckle import gaussian, mix, unit_phase, unit_uniform

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.state import Kernel

# streams of `gaussian`: the component of the persistent part that is independent of the first pass
_HIDDEN = 16
# counts of changes above this are not distinct in float32; every time then counts as a new change
_MOST_CHANGES = 1e6


@dataclass(frozen=True, eq=False)
class Age:
    r"""Change of the random numbers of scatterers with time.

    A scatterer of time constant tau changes at random moments, so that a share :math:`e^{-|t|/\tau}` of them is
    unchanged after a time t. A change preserves the persistent coherence :math:`\gamma_\infty`:

    .. math:: \gamma(t) = \gamma_\infty + (1 - \gamma_\infty) e^{-|t| / \tau}

    between any two times t apart. With z the number of the first pass, and h and n independent numbers, n new at every
    change,

    .. math:: z' = \gamma_\infty z + \sqrt{\gamma_\infty (1 - \gamma_\infty)}\, h + \sqrt{1 - \gamma_\infty}\, n :

    which has mean power one again, and coherence :math:`\gamma_\infty^2 + \gamma_\infty (1 - \gamma_\infty)` between
    any two changes.

    Parameters
    ----------
    days : since the first pass
    coherence : gamma_inf, 0 ... 1, of every lane
    decay_days : tau, of every lane; 0: every pass after the first is changed

    Notes
    -----
    Moments of change: a scatterer changes at equal intervals L from a random start, and L is drawn from the gamma
    distribution of shape 2 and scale tau. Two times t apart lie in one interval with probability
    :math:`\langle \max(1 - t/L, 0) \rangle = e^{-t/\tau}`, and no history has to be stored. Ignores common changes of
    many scatterers, as by rain, and all displacement.
    """

    days: mi.Float
    coherence: mi.Float
    decay_days: mi.Float

    @staticmethod
    def of(kernel: Kernel, table: mi.Float | None, row: mi.UInt32) -> Age | None:
        """Temporal change of scatterers; None where none changes.

        Parameters
        ----------
        table : coherence that never decays and time constant (days) of every material or medium; None: nothing changes
        row : material or medium of the scatterers
        """
        if not kernel.flags.temporal or table is None:
            return None
        kept = dr.gather(mi.Vector2f, table, row)
        return Age(kernel.constants.days, kept.x, kept.y)

    def gaussian(self, key: mi.UInt32, stream: int) -> mi.Complex2f:
        """Circular complex Gaussian of unit mean power; as in the first pass at zero days and in unchanged scatterers.

        Parameters
        ----------
        key : of the scatterer, hashed
        stream : independent ones, 0 to 15
        """
        changed, newer = self._latest(key)
        first, stays = gaussian(key, stream), self.coherence
        hidden, fresh = gaussian(key, stream + _HIDDEN), gaussian(newer, stream)
        now = (
            first * stays
            + hidden * dr.sqrt(dr.maximum(stays * (1.0 - stays), 0.0))
            + fresh * dr.sqrt(dr.maximum(1.0 - stays, 0.0))
        )
        return dr.select(changed, now, first)

    def unit_phase(self, key: mi.UInt32, stream: int) -> mi.Complex2f:
        """Phase factor of unit modulus and hashed phase; a change preserves a share gamma_inf of the scatterers."""
        changed, newer = self._latest(key)
        replaced = unit_uniform(key, 0x2545F491) >= self.coherence
        return unit_phase(dr.select(changed & replaced, newer, key), stream)

    def _latest(self, key: mi.UInt32) -> tuple[mi.Bool, mi.UInt32]:
        """Whether a scatterer has changed since the first pass, and the key of its latest change."""
        one, two = unit_uniform(key, 0x1B873593), unit_uniform(key, 0xCC9E2D51)
        piece = -dr.log(one * two) * self.decay_days
        count = self.days / dr.maximum(piece, 1e-30)
        late = count > _MOST_CHANGES
        number = dr.floor(dr.select(late, 0.0, count) + unit_uniform(key, 0xE6546B64))
        latest = dr.select(late, dr.reinterpret_array(mi.UInt32, self.days), mi.UInt32(mi.Int32(number)))
        return late | (number != 0.0), mix(key ^ mix(latest + 0x3C6EF372))
