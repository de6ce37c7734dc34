"""One self-contained HTML page of a run: the scene in 3-D, the radar's passage, its echoes and the image that they make."""
