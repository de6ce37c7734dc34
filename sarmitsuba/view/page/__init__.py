"""Web page of a run: numbers, geometry and image in one self-contained HTML file."""
