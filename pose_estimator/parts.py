"""The networks by name."""

PARTS = ("detector", "features", "volume", "cascade", "points")
"""In the order of their training, a stage each."""

OPTIONAL_PARTS = ("cascade", "points")
"""Networks that weights may lack: those of ``early`` and ``rgbd``."""
