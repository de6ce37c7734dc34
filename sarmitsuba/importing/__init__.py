"""Cities and terrain from elsewhere (footprints, CityGML, meshes, elevation rasters) as scene files."""
