"""From a plan to echoes and images: the executor, blocks, batches, passes, methods, cross sections."""
