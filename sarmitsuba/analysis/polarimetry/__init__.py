"""Polarimetry: coherency matrix, Cloude-Pottier decomposition, compact polarimetry, colours."""

from sarmitsuba.analysis.polarimetry.cloude_pottier import (
    ZONES,
    CloudePottier,
    cloude_pottier,
    orientation_angle,
)
from sarmitsuba.analysis.polarimetry.coherency import (
    coherency,
    coherency4,
    coherency_of_covariance,
    covariance,
    covariance_of_coherency,
    lexicographic_vector,
    pauli_vector,
    span,
)
from sarmitsuba.analysis.polarimetry.colours import colours, pauli_rgb
from sarmitsuba.analysis.polarimetry.compact import Stokes, m_chi, m_delta, stokes
from sarmitsuba.analysis.polarimetry.polarisation_report import (
    PolarimetryReport,
    automatic_looks,
    polarimetry_report,
)
from sarmitsuba.analysis.polarimetry.quad import QuadPol, quad_pol

__all__ = [
    "ZONES",
    "CloudePottier",
    "PolarimetryReport",
    "QuadPol",
    "Stokes",
    "automatic_looks",
    "cloude_pottier",
    "coherency",
    "coherency4",
    "coherency_of_covariance",
    "colours",
    "covariance",
    "covariance_of_coherency",
    "lexicographic_vector",
    "m_chi",
    "m_delta",
    "orientation_angle",
    "pauli_rgb",
    "pauli_vector",
    "polarimetry_report",
    "quad_pol",
    "span",
    "stokes",
]
