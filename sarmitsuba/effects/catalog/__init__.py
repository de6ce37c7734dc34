"""One effect a module; each defines ``EFFECT``. They are found by name, nothing lists them."""
