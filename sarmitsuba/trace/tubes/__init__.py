"""Ray tubes: what of a facet a ray stands for, the phase integral over it, and how curved mirrors spread it."""
