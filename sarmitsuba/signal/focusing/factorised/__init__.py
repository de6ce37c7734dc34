"""Fast factorised backprojection: division of the aperture, and the compiled steps from pulses to pixels."""
