"""Refinement of the automatic ray spacing by the measured sampling error, in place of a fixed number per wavelength."""

import math
from collections.abc import Iterable

# dB, sampling error (energy over that of the echoes) up to which the automatic ray spacing is refined, and above which
# a result is doubtful
FINE_DB, POOR_DB = -30.0, -15.0
# dB below the first for which a spacing is chosen, since errors of single lattices vary by about that
MARGIN_DB = 2.0
# dB per decade of the ray spacing: the error's energy falls with its cube for almonds, ogives, spheres and cylinders of
# 3 to 6 wavelengths (`tests/physics/test_ray_density.py`)
SLOPE_DB = 30.0
# least and greatest refinement in one step
LEAST_STEP, MOST_STEP = 2.0**0.5, 6.0
# most rays of a refined sweep, over all directions: about 20 CPU seconds
MOST_TRACED = 1e8


def fitting_spacing(error_db: float, spacing: float) -> float:
    """Ray spacing, m, at which the sampling error should be below ``FINE_DB``, from the error at another spacing."""
    return float(spacing * 10.0 ** ((FINE_DB - MARGIN_DB - error_db) / SLOPE_DB))


def finer_spacing(error_db: float, spacing: float, least: float) -> float:
    """Next ray spacing, m, on the way to ``FINE_DB``; ``spacing`` itself where the error is low or ``least`` too near.

    Parameters
    ----------
    error_db : sampling error at ``spacing``, dB
    spacing : m
    least : m, that the bound on rays allows
    """
    if error_db <= FINE_DB:
        return spacing
    wanted = min(max(fitting_spacing(error_db, spacing), spacing / MOST_STEP), spacing / LEAST_STEP)
    finer = max(wanted, least)
    # a smaller step changes the error by less than its own uncertainty
    return finer if finer * LEAST_STEP <= spacing * 1.001 else spacing


def worst(errors_db: Iterable[float]) -> float:
    """Largest sampling error of the channels with echoes, dB; -inf without echoes."""
    return max((error for error in errors_db if not math.isnan(error)), default=-math.inf)


def error_text(name: str, error_db: float, spacing: float, wavelength: float, given: bool) -> str:
    """Note on a sampling error above ``FINE_DB`` with its remedy; empty below.

    Parameters
    ----------
    name : of the scene
    error_db : sampling error at ``spacing``, dB
    spacing, wavelength : m
    given : whether the user has set the spacing
    """
    if error_db <= FINE_DB:
        return ""
    wanted = fitting_spacing(error_db, spacing)
    said = f"{name}: the sampling error is {error_db:.1f} dB with rays {spacing / wavelength:.2g} wavelengths apart"
    remedy = f"the bound on rays; set ray_spacing to about {wanted:.2g} m for {FINE_DB:g} dB"
    if given:
        remedy = "as set; leave ray_spacing out, and rays are as dense as the target needs"
    doubt = "; single directions are several dB off" if error_db > POOR_DB else ""
    return f"{said}, {remedy}{doubt}"
