"""The operator that detection needs."""

from infrablend.training.suppression import nms

__all__ = ["nms"]
