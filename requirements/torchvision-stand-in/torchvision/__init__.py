"""Stand-in for torchvision beside torch's CPU build: what detection with Ultralytics needs of it."""

from torchvision import ops

__version__ = "0.28.0+infrablend"
__all__ = ["ops"]
