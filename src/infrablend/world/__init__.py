"""The virtual thermal world, without Blender: plans of outdoor scenes, their temperatures, labels and datasets."""

from infrablend.world.frames import FrameFacts, plan_frames, plan_sequences
from infrablend.world.plan import WorldPlan
from infrablend.world.sampling import TOWN, sample_world

__all__ = ["TOWN", "FrameFacts", "WorldPlan", "plan_frames", "plan_sequences", "sample_world"]
