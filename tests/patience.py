"""How long a test waits for another process before it takes it for one that hangs."""

PATIENCE = 1800
"""s; twenty times the longest such wait on a quick machine, so that only what never ends is given up."""
