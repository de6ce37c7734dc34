"""Surface currents of metal bodies by the method of moments: basis functions, matrix and scattering amplitudes."""
