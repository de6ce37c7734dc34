"""How good an image is, and passes of rays until it is good enough."""
