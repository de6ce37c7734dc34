"""One effect per module, each registered in ``EFFECTS``; nothing else lists them."""
