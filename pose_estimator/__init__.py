"""Two images in, one pose out."""

from .fusion.loading import load
from .methods import METHODS

__all__ = ["METHODS", "load"]
