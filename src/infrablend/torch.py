"""Frames as a torch data set: inserts are composed while a model trains on them, new ones every epoch.

    from torch.utils.data import DataLoader

    from infrablend import api
    from infrablend.torch import InsertDataset

    dataset = InsertDataset(api.FramesRequest("hit-uav-drone", Path("HIT-UAV")))
    for epoch in range(10):
        dataset.set_epoch(epoch)
        for image, target in DataLoader(dataset, batch_size=None):
            ...

`DataLoader(dataset, batch_size=8, collate_fn=collate)` gives batches.

Needs torch, which `infrablend[train]` installs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from infrablend.core.arguments import require_whole
from infrablend.core.dataset import Category
from infrablend.core.rng import integer_seed, stream
from infrablend.errors import ArgumentError, MissingDependencyError
from infrablend.pipeline.compose.memory_frames import Frame, Frames, FramesRequest

try:
    import torch
    from torch.utils.data import IterableDataset, get_worker_info
except ImportError:  # reported when a data set is made
    torch = None
    IterableDataset = object


class InsertDataset(IterableDataset):  # type: ignore[misc] # torch has no types here
    """An iterable torch data set of frames with inserted objects.

    Frames are composed by warm worker processes of InfraBlend ahead of the training, so a `DataLoader` needs no workers
    of its own. If it has some, they share the frames, and each has its part of the processes.
    """

    def __init__(
        self,
        request: FramesRequest,
        *,
        shuffle: bool = True,
        new_each_epoch: bool = True,
        transform: Callable[[Frame], Any] | None = None,
    ) -> None:
        """Keep the request; recipe and backgrounds are read by the first process that needs them.

        Args:
            request: Recipe, backgrounds, seed and workers.
            shuffle: Whether each epoch has another order.
            new_each_epoch: Whether each epoch has other objects on the same backgrounds. Epoch 0 has those of a run
                with the seed of the request.
            transform: Function of a frame that gives the sample; by default `to_tensors`. It runs in the process that
                iterates.

        Raises:
            MissingDependencyError: torch is not installed.
        """
        if torch is None:
            raise MissingDependencyError(
                "infrablend.torch needs torch. Install it with: pip install 'infrablend[train]'"
            )
        super().__init__()
        self._request = request
        self._shuffle = shuffle
        self._new_each_epoch = new_each_epoch
        self._transform = transform
        self._epoch = self._position = self._start = 0
        self._open: tuple[int, Frames] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": None}  # a loader's workers open frames of their own

    @property
    def categories(self) -> tuple[Category, ...]:
        """Classes; a label is the position of its class here from 1 on, for 0 is the background of detectors."""
        return self._frames().categories

    def __len__(self) -> int:
        """Return the number of frames of an epoch over all workers, including backgrounds that cannot be used."""
        return len(self._frames())

    def set_epoch(self, epoch: int) -> None:
        """Choose order and objects; call it before each epoch."""
        require_whole("epoch", epoch, 0)
        self._epoch = epoch
        self._start = 0
        self._position = 0

    def state_dict(self) -> dict[str, int]:
        """Return the epoch, and the number of its frames that this process has passed."""
        return {"epoch": self._epoch, "position": self._position}

    def load_state_dict(self, state: Mapping[str, int]) -> None:
        """Continue where `state_dict` was taken: the next iteration starts with the frame after it.

        Without workers of the loader, or with torchdata's `StatefulDataLoader`, which keeps the state of each worker.

        Raises:
            ArgumentError: The state is not one that `state_dict` returned.
        """
        if not isinstance(state, Mapping) or not {"epoch", "position"} <= state.keys():
            raise ArgumentError(f"state: found {state!r}, expected what state_dict() returned")
        self.set_epoch(state["epoch"])
        require_whole("position", state["position"], 0)
        self._start = self._position = state["position"]

    def __iter__(self) -> Iterator[Any]:
        worker = get_worker_info()
        number, count = (0, 1) if worker is None else (worker.id, worker.num_workers)
        frames = self._frames(count)
        order = np.arange(len(frames))
        if self._shuffle:
            order = stream(frames.seed, "order", self._epoch).permutation(len(frames))
        ids = [frames.ids[k] for k in order[number::count]]
        seed = frames.seed
        if self._new_each_epoch and self._epoch:
            seed = integer_seed(frames.seed, "epoch", self._epoch)
        position = {frame_id: k for k, frame_id in enumerate(ids)}
        start = self._start
        self._start = 0
        transform = self._transform or partial(to_tensors, categories=frames.categories)
        for frame in frames.iterate(ids[start:], seed):
            # Before the sample is used: what the caller has got is passed. Skipped backgrounds count as passed, too.
            self._position = position[frame.id] + 1
            yield transform(frame)
        self._position = len(ids)

    def close(self) -> None:
        """End the worker processes."""
        if self._open is not None:
            self._open[1].close()
            self._open = None

    def _frames(self, loader_workers: int = 1) -> Frames:
        """Return the frames of this process; after a fork the parent's workers stay the parent's."""
        process = os.getpid()
        if self._open is None or self._open[0] != process:
            execution = self._request.execution
            if loader_workers > 1 and not execution.in_process:
                execution = replace(execution, workers=max(1, execution.worker_count() // loader_workers))
            self._open = process, Frames(replace(self._request, execution=execution))
        return self._open[1]


def to_tensors(frame: Frame, categories: tuple[Category, ...]) -> tuple[Any, dict[str, object]]:
    """Return a frame in the form of torchvision's detectors, which have one class more than `categories`.

    Returns:
        The picture as a float32 tensor (1, h, w) from 0 to 1; and `boxes` (n, 4) float32 x0, y0, x1, y1 in pixels,
        `labels` (n,) int64 positions in `categories` from 1 on (0 is the detectors' background), `inserted` (n,) bool,
        and `id`. Ignore regions are left out.
    """
    number = {c.name: k for k, c in enumerate(categories, 1)}
    ignored = {c.name for c in categories if c.ignore}
    labels = [i for i in frame.labels if i.category not in ignored]
    top = np.iinfo(frame.pixels.dtype).max
    boxes = np.array([i.box_xyxy for i in labels], np.float32).reshape(-1, 4)
    return torch.from_numpy((frame.pixels / np.float32(top)).astype(np.float32)[None]), {
        "boxes": torch.from_numpy(boxes),
        "labels": torch.tensor([number[i.category] for i in labels], dtype=torch.int64),
        "inserted": torch.tensor([i.inserted for i in labels], dtype=torch.bool),
        "id": frame.id,
    }


def collate(samples: Iterable[tuple[Any, Any]]) -> tuple[list[Any], list[Any]]:
    """Return the pictures and the targets of a batch as two lists, which torchvision's detectors take.

    For `DataLoader(dataset, batch_size=8, collate_fn=collate)`: torch's own function cannot stack targets with
    different numbers of objects. Pictures are not stacked, for they may differ in size.
    """
    images = []
    targets = []
    for image, target in samples:
        images.append(image)
        targets.append(target)
    return images, targets
