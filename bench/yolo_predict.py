"""Read pictures with Ultralytics' own prediction, as other programs do, and write its detections for an evaluation.

    .venv/bin/python bench/yolo_predict.py WEIGHTS DATA OUT.json [--split test] [--imgsz PX]
    .venv/bin/infrablend evaluate OUT.json DATA --out DIR

Pictures go in at their own size: `imgsz` is the longer side of each, and the confidence 0.001. `evaluate` adds
a border of grey to each picture and keeps several classes per box; the prediction does neither.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from PIL import Image

from infrablend import api
from infrablend.detection.detections import MAX_DETECTIONS, Predictions, detections, write_predictions
from infrablend.detection.truth import image_key
from infrablend.detection.ultralytics_environment import quiet_ultralytics


def main() -> None:
    """Write the detections in the form of `predictions.json`."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("weights", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--split", default="test")
    parser.add_argument("--imgsz", type=int)
    args = parser.parse_args()
    images = [i for i in api.read_dataset(args.data).images if i.split == args.split]
    found = {}
    sizes = {}
    with quiet_ultralytics():
        from ultralytics import YOLO

        detector = YOLO(str(args.weights))
        for image in images:
            key = image_key(image)
            with Image.open(image.path) as picture:
                sizes[key] = picture.size
            size = args.imgsz or max(sizes[key])
            (its,) = detector.predict(str(image.path), imgsz=size, conf=0.001, max_det=MAX_DETECTIONS, verbose=False)
            boxes = its.boxes
            found[key] = detections(boxes.xyxy.tolist(), boxes.conf.tolist(), boxes.cls.tolist())
    classes = tuple(str(detector.names[k]) for k in sorted(detector.names))
    write_predictions(args.out, Predictions("detect", classes, found, sizes, {"weights": args.weights.name}))
    print(f"{sum(map(len, found.values()))} detections in {len(images)} pictures: {args.out}")


if __name__ == "__main__":
    main()
