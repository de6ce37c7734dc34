"""Closed forms that the simulator is assessed against, gathered under one name."""

from sarmitsuba.theory.bistatic import bistatic_po, bistatic_range, corner_line
from sarmitsuba.theory.building import BuildingRcs, canonical_building, kirchhoff_sigma0
from sarmitsuba.theory.fresnel import fresnel, normal_wavenumber
from sarmitsuba.theory.geometry import (
    BridgeReturns,
    BuildingReturns,
    bridge_returns,
    building_returns,
    foreshortening,
    slant_offset,
)
from sarmitsuba.theory.mie import sphere_mie, sphere_po, sphere_po_amplitude
from sarmitsuba.theory.rcs import (
    DihedralAmplitudes,
    coherent_loss,
    cylinder_rcs,
    dihedral,
    disc_rcs,
    plate_amplitude,
    plate_rcs,
    rolled_dihedral,
    trihedral_rcs,
    wall_ground_amplitude,
)
from sarmitsuba.theory.rough_surface import (
    integral_equation_sigma0,
    shared_energy_sigma0,
    small_perturbation_sigma0,
    small_slope_sigma0,
)
from sarmitsuba.theory.statistics import (
    SpeckleTest,
    equivalent_number_of_looks,
    intensity_test,
    phase_test,
    received_power,
    single_pulse_snr,
    speckle_cdf,
)

__all__ = [
    "BridgeReturns",
    "BuildingRcs",
    "BuildingReturns",
    "DihedralAmplitudes",
    "SpeckleTest",
    "bistatic_po",
    "bistatic_range",
    "bridge_returns",
    "building_returns",
    "canonical_building",
    "coherent_loss",
    "corner_line",
    "cylinder_rcs",
    "dihedral",
    "disc_rcs",
    "equivalent_number_of_looks",
    "foreshortening",
    "fresnel",
    "integral_equation_sigma0",
    "intensity_test",
    "kirchhoff_sigma0",
    "normal_wavenumber",
    "phase_test",
    "plate_amplitude",
    "plate_rcs",
    "received_power",
    "rolled_dihedral",
    "shared_energy_sigma0",
    "single_pulse_snr",
    "slant_offset",
    "small_perturbation_sigma0",
    "small_slope_sigma0",
    "speckle_cdf",
    "sphere_mie",
    "sphere_po",
    "sphere_po_amplitude",
    "trihedral_rcs",
    "wall_ground_amplitude",
]
