"""Non-maximum suppression as torchvision computes it, for installations whose torchvision does not fit their torch.

The package registry has torchvision for Linux with CUDA only. Its compiled operators do not load beside the CPU build
of torch, and detection needs one of them, `nms`. Ultralytics' own replacement handles one detection at a time with
torch operations, which takes longer than the network. It also sorts unstably, so that the order of equal scores, and
thus the result, depends on the processor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from torch import Tensor

_BLOCK = 64


def nms(boxes: Tensor, scores: Tensor, iou_threshold: float) -> Tensor:
    """Return the indices of the boxes that non-maximum suppression keeps, like `torchvision.ops.nms`.

    Args:
        boxes: (n, 4) left, top, right, bottom.
        scores: (n,) confidences; equal ones keep their order.
        iou_threshold: Intersection over union above which the box with the lower score is dropped.

    Returns:
        (k,) int64 indices, highest score first, on the device of `boxes`.
    """
    import torch

    kept = kept_indices(boxes.detach().float().cpu().numpy(), scores.detach().float().cpu().numpy(), iou_threshold)
    return torch.from_numpy(kept).to(boxes.device)


def kept_indices(
    boxes_xyxy: NDArray[np.float32], scores: NDArray[np.float32], iou_threshold: float
) -> NDArray[np.int64]:
    """Return the indices that `nms` returns, for arrays.

    Boxes are processed in blocks of descending score: the boxes kept so far suppress boxes of the block at once, then
    the remaining boxes of the block suppress each other one by one.
    """
    order = np.argsort(-scores, kind="stable")
    boxes = boxes_xyxy[order]
    kept = np.zeros(0, np.int64)
    for start in range(0, len(boxes), _BLOCK):
        block = np.arange(start, min(start + _BLOCK, len(boxes)))
        block = block[~(_iou(boxes[kept], boxes[block]) > iou_threshold).any(axis=0)]
        hides = _iou(boxes[block], boxes[block]) > iou_threshold
        hidden = np.zeros(len(block), np.bool_)
        for k in range(len(block)):
            if not hidden[k]:
                hidden[k + 1 :] |= hides[k, k + 1 :]
        kept = np.concatenate([kept, block[~hidden]])
    return order[kept]


def _iou(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, m) intersection over union, in the order of operations of torchvision; NaN where both boxes are empty."""
    left, top = (np.maximum(a[:, None, k], b[None, :, k]) for k in (0, 1))
    right, bottom = (np.minimum(a[:, None, k], b[None, :, k]) for k in (2, 3))
    shared = np.maximum(right - left, 0) * np.maximum(bottom - top, 0)
    areas_a, areas_b = ((x[:, 2] - x[:, 0]) * (x[:, 3] - x[:, 1]) for x in (a, b))
    with np.errstate(divide="ignore", invalid="ignore"):
        overlap: NDArray[np.float32] = shared / (areas_a[:, None] + areas_b[None] - shared)
    return overlap
