"""Closed forms that the simulator is assessed against, gathered under one name."""

from sarmitsuba.theory.ambiguity import (
    azimuth_ambiguity_ratio,
    azimuth_ghost,
    azimuth_ghost_level,
    range_ambiguity_ratio,
)
from sarmitsuba.theory.beam import (
    doppler_centroid,
    gaussian_gain,
    mispointed_level,
    uniform_aperture_gain,
)
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
from sarmitsuba.theory.link import (
    minimum_antenna_area,
    nesz_of_average_power,
    nesz_of_cells,
    point_snr,
    uniform_aperture_taper,
)
from sarmitsuba.theory.mie import sphere_mie, sphere_po, sphere_po_amplitude
from sarmitsuba.theory.orbit import OrbitDoppler, circular_orbit_doppler, orbital_speed
from sarmitsuba.theory.pulse_timing import jitter_noise, jittered_response, staggered_line, staggered_lines
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
from sarmitsuba.theory.synthetic_aperture import (
    aperture_cell,
    beam_cell,
    beam_taper,
    circular_response,
    half_power_width,
)

__all__ = [
    "BridgeReturns",
    "BuildingRcs",
    "BuildingReturns",
    "DihedralAmplitudes",
    "OrbitDoppler",
    "SpeckleTest",
    "aperture_cell",
    "azimuth_ambiguity_ratio",
    "azimuth_ghost",
    "azimuth_ghost_level",
    "beam_cell",
    "beam_taper",
    "bridge_returns",
    "building_returns",
    "canonical_building",
    "circular_orbit_doppler",
    "circular_response",
    "coherent_loss",
    "cylinder_rcs",
    "dihedral",
    "disc_rcs",
    "doppler_centroid",
    "equivalent_number_of_looks",
    "foreshortening",
    "fresnel",
    "gaussian_gain",
    "half_power_width",
    "integral_equation_sigma0",
    "intensity_test",
    "jitter_noise",
    "jittered_response",
    "kirchhoff_sigma0",
    "minimum_antenna_area",
    "mispointed_level",
    "nesz_of_average_power",
    "nesz_of_cells",
    "normal_wavenumber",
    "orbital_speed",
    "phase_test",
    "plate_amplitude",
    "plate_rcs",
    "point_snr",
    "range_ambiguity_ratio",
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
    "staggered_line",
    "staggered_lines",
    "trihedral_rcs",
    "uniform_aperture_gain",
    "uniform_aperture_taper",
    "wall_ground_amplitude",
]
