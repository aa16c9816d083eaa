"""Train a small network on inserts that are composed while it trains, other ones in every epoch.

    python examples/train_while_composing.py DATA [--epochs 3] [--renderer flat]

The network learns where the drones are, on a grid of 16 x 16 pixels. It is a sketch of a training loop and no detector.
Needs torch: pip install 'infrablend[train]'
"""

import argparse
from pathlib import Path

import torch
from torch import nn
from torch.utils.data import DataLoader

from infrablend import api
from infrablend.torch import InsertDataset

CELL_PX = 16

parser = argparse.ArgumentParser()
parser.add_argument("data", type=Path)
parser.add_argument("--recipe", default="hit-uav-drone")
parser.add_argument("--epochs", type=int, default=3)
parser.add_argument("--renderer", default="blender", help="flat needs no Blender")
options = parser.parse_args()


def target(image: torch.Tensor, labels: dict) -> torch.Tensor:
    """Return 1 in the cells with the middle of an inserted object, else 0."""
    cells = torch.zeros(1, image.shape[-2] // CELL_PX, image.shape[-1] // CELL_PX)
    middles = (labels["boxes"][labels["inserted"]].reshape(-1, 2, 2).mean(dim=1) / CELL_PX).long()
    for x, y in middles.tolist():
        cells[0, min(y, cells.shape[1] - 1), min(x, cells.shape[2] - 1)] = 1
    return cells


torch.manual_seed(0)
model = nn.Sequential(
    nn.Conv2d(1, 8, 5, stride=4, padding=2), nn.ReLU(), nn.Conv2d(8, 16, 5, stride=4, padding=2), nn.ReLU(),
    nn.Conv2d(16, 1, 1),
)  # fmt: skip
optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
loss_of = nn.BCEWithLogitsLoss(pos_weight=torch.tensor(50.0))

request = api.FramesRequest(options.recipe, options.data, execution=api.Execution(renderer=options.renderer))
dataset = InsertDataset(request)
# InfraBlend's own workers compose ahead of the training, so the loader needs none.
loader = DataLoader(dataset, batch_size=None)
for epoch in range(options.epochs):
    dataset.set_epoch(epoch)
    losses = []
    for image, labels in loader:
        loss = loss_of(model(image[None]), target(image, labels)[None])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
        state = {"model": model.state_dict(), "data": dataset.state_dict()}  # save it to resume here
    print(f"epoch {epoch}: {len(losses)} frames, loss {sum(losses) / len(losses):.3f}, next {state['data']}")
dataset.close()
