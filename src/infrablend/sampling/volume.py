"""Space that an object takes up, so that no insert is placed inside another one.

Boxes in the picture do not show this: cars in a row may hide each other and still be metres apart, seen at a low angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infrablend.core.camera import object_to_world
from infrablend.core.mesh import FloatArray
from infrablend.sampling.placement import PlacementRequest, Pose


@dataclass(frozen=True, eq=False)
class Volume:
    """Upright box around an object, turned as the object is.

    Attributes:
        corners_xy: (4, 2) corners in world x and y, in order, metres.
        z_m: (2,) lowest and highest z.
    """

    corners_xy: FloatArray
    z_m: FloatArray

    def intersects(self, other: Volume) -> bool:
        """Return whether both volumes share more than an edge or a face."""
        if min(self.z_m[1], other.z_m[1]) <= max(self.z_m[0], other.z_m[0]):
            return False
        for sides in (self.corners_xy[1:3] - self.corners_xy[:2], other.corners_xy[1:3] - other.corners_xy[:2]):
            # Rectangles are apart if their projections on a side of one of them are.
            for side in sides:
                a, b = self.corners_xy @ side, other.corners_xy @ side
                if min(a.max(), b.max()) <= max(a.min(), b.min()):
                    return False
        return True


def volume_of(item: PlacementRequest, pose: Pose) -> Volume:
    """Return the volume of an object's labelled parts."""
    vertices = item.labelled_vertices_m
    (x0, y0, z0), (x1, y1, z1) = vertices.min(axis=0), vertices.max(axis=0)
    corners = np.array([(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z1)], np.float64)
    world = object_to_world(corners, pose[:3], pose[3], item.scale)
    return Volume(world[:, :2], world[[0, 3], 2])
