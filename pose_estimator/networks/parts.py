"""The networks by name."""

PARTS = ("detector", "features", "volume", "cascade", "points")
"""In the order of their training."""

STAGES = ("detector", "features", "decoders", "volume", "cascade", "points")
"""What a training consists of: a stage for each network, and two for the 2D features."""

OPTIONAL_PARTS = ("cascade", "points")
"""Networks that weights may lack: those of ``early`` and ``rgbd``."""
