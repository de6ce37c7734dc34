"""Temporal coherence of surfaces and volumes between two passes."""

from collections.abc import Mapping

import numpy as np

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Param, Value, float_value

# parameters common to surfaces and volumes
CHANGE = (
    Param(
        "temporal_coherence",
        "float",
        1.0,
        "coherence of the diffuse return between two passes long apart; 1 = no change",
        "",
        0.0,
        1.0,
    ),
    Param(
        "decorrelation_days",
        "float",
        0.0,
        "time constant of the exponential decay to temporal_coherence; 0 = at once, in every pass",
        "days",
        0.0,
        1e6,
    ),
)


def coherence_after(days: float, stays: float, decay_days: float) -> float:
    r"""Coherence of the incoherent return between two passes.

    .. math:: \gamma(t) = \gamma_\infty + (1 - \gamma_\infty) e^{-|t| / \tau}

    Parameters
    ----------
    days : t
    stays : gamma_inf, 0 ... 1
    decay_days : tau; 0: at once
    """
    if days == 0.0:
        return 1.0
    left = float(np.exp(-abs(days) / decay_days)) if decay_days > 0.0 else 0.0
    return stays + (1.0 - stays) * left


def change_of(
    values: Mapping[str, Value | None], given: frozenset[str], where: str, usual: float = 1.0
) -> tuple[float, float]:
    """Long-term coherence and time constant (days) from validated parameters.

    ``usual`` : default coherence

    Raises
    ------
    SceneError
        A time constant without effect.
    """
    stays = float_value(values, "temporal_coherence") if "temporal_coherence" in given else usual
    days = float_value(values, "decorrelation_days")
    if "decorrelation_days" in given and stays == 1.0:
        raise SceneError(
            f"{where}: decorrelation_days = {days:g} days has no effect with temporal_coherence = 1; give the "
            "long-term coherence, such as 0"
        )
    return stays, days
