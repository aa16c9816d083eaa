"""Make a stand-in for another thermal camera of pictures in visible light: grey, inverted, so that drones are bright.

    .venv/bin/python bench/inverted_visible.py DATA OUT [--split train] [--every 2]
    .venv/bin/infrablend evaluate WEIGHTS OUT/dataset --split test --out DIR

Drones in front of a bright sky become bright ones in front of a dark sky, larger than those of the thermal clips.
Those that reflect the sun become dark, as no thermal camera shows them: figures compare detectors with each other only.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import cv2

from infrablend import api
from infrablend.formats import writing


def main() -> None:
    """Write the pictures of a split, inverted, as the test split of a COCO dataset."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--split", default="train")
    parser.add_argument("--every", type=int, default=2)
    args = parser.parse_args()
    dataset = api.read_dataset(args.data)
    inverted = args.out / "inverted"
    inverted.mkdir(parents=True)
    images = []
    for image in [i for i in dataset.images if i.split == args.split][:: args.every]:
        path = inverted / f"{image.path.stem}.png"
        cv2.imwrite(str(path), 255 - cv2.imread(str(image.path), cv2.IMREAD_GRAYSCALE))
        images.append(replace(image, path=path, file_name=path.name, split="test"))
    writing.write("coco", args.out / "dataset", images, dataset.categories)
    print(f"{len(images)} pictures: {args.out / 'dataset'}")


if __name__ == "__main__":
    main()
