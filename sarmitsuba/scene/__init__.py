"""Scene files: parameters, materials, meshes and radar, loaded into frozen data."""
