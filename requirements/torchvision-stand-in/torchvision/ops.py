"""The operator that detection needs."""

from infrablend.detection.ultralytics_environment import nms

__all__ = ["nms"]
