"""Triangle meshes: cleaning, welding, smooth groups, boundary edges, curvature, convexity, tessellation."""
