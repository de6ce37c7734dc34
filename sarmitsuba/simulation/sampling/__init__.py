"""How densely a run samples its scene: launch window, cells, lattices, pieces of a scene."""
