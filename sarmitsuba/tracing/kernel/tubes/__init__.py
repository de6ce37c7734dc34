"""Ray tubes: footprint on a facet, phase integral over it, and spreading by curved mirrors."""
