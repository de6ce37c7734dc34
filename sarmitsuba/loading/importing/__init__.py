"""Import of cities and terrain (footprints, CityGML, meshes, elevation rasters) as scene files."""
