"""Comparisons that need torch: a small network trained on the crops, and Inception features for KID."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.rng import stream
from infrablend.lab.realism.classify import Score, auc, bootstrap, group_folds, group_numbers
from infrablend.lab.realism.features import Measured

EPOCHS = 12
BATCH = 64
LEAST_CROPS = 1000
WEIGHTS = "inception_v3_google-0cc3c7bd.pth"  # torchvision's, trained on ImageNet
_SIDE = 299
_MEAN = (0.485, 0.456, 0.406)
_SD = (0.229, 0.224, 0.225)


def missing(*modules: str) -> str | None:
    """Return a message such as `torch is not installed`, or None if all modules are installed."""
    absent = [m for m in modules if importlib.util.find_spec(m) is None]
    return f"{' and '.join(absent)} {'is' if len(absent) == 1 else 'are'} not installed" if absent else None


def score_crops(real: Sequence[Measured], other: Sequence[Measured], epochs: int = EPOCHS) -> Score:
    """Score a small convolutional network on the 48 px crops, in the same folds as the other classifiers.

    Four convolutions, trained from scratch for each fold with random mirroring. Runs on the CPU, so that the same crops
    give the same score. Needs torch.
    """
    import torch

    crops = np.stack([m.patch for m in (*real, *other)]).astype(np.float32)[:, None] / 127.5 - 1
    y = np.repeat([0, 1], [len(real), len(other)])
    groups = group_numbers([*real, *other])
    predictions = np.zeros(len(y))
    before = torch.get_deterministic_debug_mode()
    threads = torch.get_num_threads()
    torch.set_deterministic_debug_mode("error")  # use_deterministic_algorithms would import torch's compiler
    torch.set_num_threads(1)  # rounding of sums depends on the number of threads
    try:
        for fold, (train, test) in enumerate(group_folds(groups)):
            net = _train(crops[train], y[train], epochs, fold)
            with torch.no_grad():
                out = [net(torch.from_numpy(crops[part])) for part in np.array_split(test, max(1, len(test) // 256))]
            predictions[test] = torch.cat(out).numpy().ravel().astype(np.float64)
    finally:
        torch.set_deterministic_debug_mode(before)
        torch.set_num_threads(threads)
    return Score(auc(y, predictions), bootstrap(y, predictions, groups), predictions)


def _train(crops: NDArray[np.float32], y: NDArray[np.int64], epochs: int, fold: int) -> Any:
    import torch
    from torch import nn

    torch.manual_seed(fold)
    layers: list[Any] = []
    for before, after in ((1, 16), (16, 32), (32, 64), (64, 64)):
        layers += [nn.Conv2d(before, after, 3, padding=1), nn.BatchNorm2d(after), nn.ReLU(), nn.MaxPool2d(2)]
    net = nn.Sequential(*layers, nn.Flatten(), nn.Dropout(0.3), nn.Linear(64 * 9, 1))
    step = torch.optim.AdamW(net.parameters(), lr=1e-3, weight_decay=1e-2)
    loss = nn.BCEWithLogitsLoss()
    rng = stream(fold, "crops")
    for _ in range(epochs):
        order = rng.permutation(len(y))
        for part in (order[k : k + BATCH] for k in range(0, len(order) - 1, BATCH)):
            if len(part) < 2:  # too few for batch normalisation
                continue
            batch = crops[part]
            if rng.random() < 0.5:
                batch = batch[..., ::-1]
            step.zero_grad()
            given = net(torch.from_numpy(np.ascontiguousarray(batch)))
            loss(given[:, 0], torch.from_numpy(y[part].astype(np.float32))).backward()
            step.step()
    return net.eval()


def no_inception(crops: int) -> str | None:
    """Return the reason why KID cannot be computed for this number of crops; None if it can."""
    if crops < LEAST_CROPS:
        return f"{crops} crops; {LEAST_CROPS} are needed"
    if reason := missing("torch", "torchvision"):
        return reason
    try:
        importlib.import_module("torchvision.models")
    except (ImportError, RuntimeError) as error:  # built for another torch
        return f"torchvision cannot be imported ({error}); install the build for the installed torch"
    if not _weights().is_file():
        return f"the weights of Inception ({WEIGHTS}) are not in torch's cache; they are not downloaded automatically"
    return None


def _weights() -> Path:
    import torch

    return Path(torch.hub.get_dir()) / "checkpoints" / WEIGHTS


def inception_features(objects: Sequence[Measured]) -> NDArray[np.float64]:
    """Return the (n, 2048) pooled Inception features of the crops, enlarged to 299 px, grey in all three channels.

    The network is torchvision's, trained on ImageNet, and not that of published KID figures; do not compare with those.
    """
    import torch
    from torchvision.models import inception_v3

    net = inception_v3(weights=None, init_weights=False, aux_logits=True, transform_input=False)
    net.load_state_dict(torch.load(_weights(), map_location="cpu", weights_only=True))
    net.fc = torch.nn.Identity()
    net.eval()
    found = []
    mean = np.array(_MEAN, np.float32)
    sd = np.array(_SD, np.float32)
    for start in range(0, len(objects), 32):
        crops = [
            cv2.resize(m.patch.astype(np.float32) / 255, (_SIDE, _SIDE), interpolation=cv2.INTER_CUBIC)
            for m in objects[start : start + 32]
        ]
        batch = (np.stack(crops)[:, None] - mean[:, None, None]) / sd[:, None, None]
        with torch.no_grad():
            found.append(net(torch.from_numpy(batch.astype(np.float32))).numpy())
    return np.asarray(np.concatenate(found), np.float64)
