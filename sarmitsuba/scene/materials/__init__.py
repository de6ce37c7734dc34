"""Materials: permittivity, Fresnel coefficients, roughness, diffuse laws, slabs, vegetation."""
