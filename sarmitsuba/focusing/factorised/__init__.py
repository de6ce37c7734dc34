"""Fast factorised backprojection: how the aperture is divided, and the compiled steps from pulses to pixels."""
