"""Scatterers that change between two passes: the random numbers that they have a given time after the first.

Nothing is kept from pass to pass. Every run works out from a scatterer's key, its material and the days since the first
pass what the scatterer has become, so that any two runs of one scene share what has not changed between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sarmitsuba.backend import dr, mi
from sarmitsuba.trace.scene_tables import MATERIAL_MASK
from sarmitsuba.trace.speckle import gaussian, mix, unit_phase, unit_uniform

if TYPE_CHECKING:
    from sarmitsuba.trace.state import Kernel

# streams of `gaussian`: what the first pass cannot tell of the part that stays
_HIDDEN = 16
# more changes than this have no number of their own in float32; every time is then another one
_MOST_CHANGES = 1e6


@dataclass(frozen=True, eq=False)
class Age:
    r"""What time does to the random numbers of scatterers.

    A scatterer of time constant tau is changed at random moments, so that a share :math:`e^{-|t|/\tau}` of them is
    as it was a time t before. A change leaves of it what is there to stay, the coherence :math:`\gamma_\infty`:

    .. math:: \gamma(t) = \gamma_\infty + (1 - \gamma_\infty) e^{-|t| / \tau}

    between any two times t apart. With z the number of the first pass, h and n independent ones, the last of the last
    change,

    .. math:: z' = \gamma_\infty z + \sqrt{\gamma_\infty (1 - \gamma_\infty)}\, h + \sqrt{1 - \gamma_\infty}\, n :

    of mean power one again, and of coherence :math:`\gamma_\infty^2 + \gamma_\infty (1 - \gamma_\infty)` with every
    other change too.

    Parameters
    ----------
    days : since the first pass
    coherence : gamma_inf, 0 ... 1, of every lane
    decay_days : tau, of every lane; 0: all is changed in every pass but the first

    Notes
    -----
    Moments of change: a scatterer's life is cut at equal distances L from a random start, and L is drawn from the gamma
    distribution of shape 2 and scale tau. Two times t apart lie in one piece with the probability
    :math:`\langle \max(1 - t/L, 0) \rangle = e^{-t/\tau}`, and no history has to be gone through. Ignores that several
    scatterers change together, as under rain, and all displacement.
    """

    days: mi.Float
    coherence: mi.Float
    decay_days: mi.Float

    @staticmethod
    def of(kernel: Kernel, material: mi.UInt32) -> Age | None:
        """What time has done to the scatterers of a material, None where no surface changes.

        ``material`` : as :class:`sarmitsuba.trace.state.Hit` has it
        """
        table = kernel.scene.change_table
        if not kernel.flags.temporal or table is None:
            return None
        row = dr.gather(mi.Vector2f, table, material & MATERIAL_MASK)
        return Age(kernel.constants.days, row.x, row.y)

    def gaussian(self, key: mi.UInt32, stream: int) -> mi.Complex2f:
        """Circular complex Gaussian of unit mean power; at no days and in unchanged scatterers that of the first pass.

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
        """Unit modulus and a hashed phase; a change leaves a share gamma_inf of the scatterers untouched."""
        changed, newer = self._latest(key)
        replaced = unit_uniform(key, 0x2545F491) >= self.coherence
        return unit_phase(dr.select(changed & replaced, newer, key), stream)

    def _latest(self, key: mi.UInt32) -> tuple[mi.Bool, mi.UInt32]:
        """Whether a scatterer is another one than in the first pass, and the key of its latest change."""
        one, two = unit_uniform(key, 0x1B873593), unit_uniform(key, 0xCC9E2D51)
        piece = -dr.log(one * two) * self.decay_days
        count = self.days / dr.maximum(piece, 1e-30)
        late = count > _MOST_CHANGES
        number = dr.floor(dr.select(late, 0.0, count) + unit_uniform(key, 0xE6546B64))
        latest = dr.select(late, dr.reinterpret_array(mi.UInt32, self.days), mi.UInt32(mi.Int32(number)))
        return late | (number != 0.0), mix(key ^ mix(latest + 0x3C6EF372))


__all__ = ["Age"]
