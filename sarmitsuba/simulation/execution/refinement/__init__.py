"""Error bars of an image, and passes of rays until a target error is reached."""
