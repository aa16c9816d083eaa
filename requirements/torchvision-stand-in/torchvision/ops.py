"""The operator that detection needs."""

from infrablend.training.environment import nms

__all__ = ["nms"]
