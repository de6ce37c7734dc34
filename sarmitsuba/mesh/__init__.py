"""Triangle meshes: reading, cleaning, tessellation, boundary edges, curvature, convexity."""
