"""Derivatives of raw data and images by parameters of a scene, and fits of such parameters to measured raw data.

Modules touched, and the data that flows::

    parameters        names, values; a scene with other values; which derivatives of echoes each needs
        -> forward model  one plan (rays, blocks of pulses, effects) that stays the same for all values
        -> trace      :mod:`sarmitsuba.tracing.derivatives.tangents`: along every traced path the derivative of the
                      slant range by
                      displacements of antenna and shapes is part of the ray's state; each echo is added to its cells
                      with these as further channels
        -> bin, echo  the grids of the further channels become range profiles like all others, with the factor
                      -j 4 pi (f_c + f) / c on the spectrum where the slant range changes
        -> jacobian   sums of these by parameter, (n_parameters, channels, pulses, samples)
        -> fit        least squares with that matrix
        -> reverse    for many parameters and one loss: adjoint data of the loss go backwards through the synthesis to
                      adjoint grids, from which every echo reads the factor of its own derivatives
                      (:mod:`sarmitsuba.tracing.derivatives.echo_derivatives` and ``tangent_slots`` there)

Without parameters the trace kernel, its data and its time are what they are without this package.
"""
