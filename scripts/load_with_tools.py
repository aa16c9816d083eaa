"""What other libraries make of a dataset: `load_with_tools.py TOOL FORMAT FOLDER`, run by .venv-tools.

TOOL is supervision, datumaro or datasets (Hugging Face's), FORMAT a name as in `infrablend convert --to`, FOLDER what
that wrote. Writes one JSON list to standard output: an
item per image, sorted, with

    split, stem    which image (Supervision knows no splits in VOC: empty there)
    size_wh        as the library sees it
    objects        [class name, x0, y0, x1, y1, corners or null, mask's pixels or null] as loaded, sorted; Datumaro has
                   boxes and masks apart, as objects of their own

Exit code 0: loaded; 1: the library refuses the dataset; 2: it has no reader for the format. Nothing goes over the
network.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path, PurePosixPath
from typing import Any

SPLITS = ("train", "val", "test")
DATUMARO = {"coco": "coco_instances", "yolo": "yolo", "voc": "voc_detection", "dota": "dota", "cvat": "cvat"}


def with_supervision(format_: str, folder: Path) -> list[dict[str, Any]]:
    """Every split loaded by `supervision.DetectionDataset`."""
    import supervision as sv

    loaded = []
    for split in SPLITS:
        pictures = folder / "images" / split
        if format_ == "coco" and pictures.is_dir():
            data = sv.DetectionDataset.from_coco(str(pictures), str(folder / f"annotations/instances_{split}.json"))
        elif format_ in ("yolo", "yolo-obb", "yolo-seg") and pictures.is_dir():
            labels, described = folder / "labels" / split, folder / "data.yaml"
            data = sv.DetectionDataset.from_yolo(
                str(pictures), str(labels), str(described), is_obb=format_ == "yolo-obb"
            )
        elif format_ == "voc" and split == "train":  # Supervision knows no splits in VOC: one folder is all
            data = sv.DetectionDataset.from_pascal_voc(str(folder / "JPEGImages"), str(folder / "Annotations"))
        else:
            continue
        for path, picture, found in data:
            corners = found.data.get("xyxyxyxy")
            objects = [
                [
                    data.classes[int(found.class_id[k])],
                    *(float(v) for v in found.xyxy[k]),
                    None if corners is None else [[float(v) for v in p] for p in corners[k]],
                    None if found.mask is None else int(found.mask[k].sum()),
                ]
                for k in range(len(found))
            ]
            size = [int(picture.shape[1]), int(picture.shape[0])]
            name = "" if format_ == "voc" else split
            loaded.append({"split": name, "stem": Path(path).stem, "size_wh": size, "objects": objects})
    return loaded


def with_datumaro(format_: str, folder: Path) -> list[dict[str, Any]]:
    """Return the folder loaded by `datumaro.Dataset.import_from`."""
    from datumaro.components.annotation import AnnotationType
    from datumaro.components.dataset import Dataset

    data = Dataset.import_from(str(folder), DATUMARO[format_])
    names = [label.name for label in data.categories()[AnnotationType.label]]
    loaded = []
    for item in data:
        objects = []
        for a in item.annotations:
            if a.type not in (AnnotationType.bbox, AnnotationType.rotated_bbox, AnnotationType.mask):
                continue
            corners = area = None
            if a.type == AnnotationType.rotated_bbox:
                corners = [[float(x), float(y)] for x, y in a.as_polygon()]
                xs, ys = zip(*corners, strict=True)
                box = [min(xs), min(ys), max(xs), max(ys)]
            else:
                x, y, w, h = a.get_bbox()
                box = [x, y, x + w, y + h]
                if a.type == AnnotationType.mask:
                    area = int(a.image.sum())
            label = None if a.label is None else names[a.label]
            objects.append([label, *(float(v) for v in box), corners, area])
        height, width = item.media.size
        stem = PurePosixPath(item.id).name
        loaded.append({"split": item.subset, "stem": stem, "size_wh": [width, height], "objects": objects})
    return loaded


def with_datasets(format_: str, folder: Path) -> list[dict[str, Any]]:
    """Return the folder loaded by `datasets.load_dataset("imagefolder", ...)`."""
    if format_ == "shards":
        return shards_with_datasets(folder)
    if format_ != "huggingface":
        raise KeyError(format_)
    import tempfile

    import datasets
    from pycocotools import mask

    datasets.disable_progress_bars()
    loaded = []
    with tempfile.TemporaryDirectory() as cache:
        data = datasets.load_dataset("imagefolder", data_dir=str(folder), cache_dir=cache)
        for split, rows in data.items():
            for row in rows:
                image, found = row["image"], row["objects"]
                none = [None] * len(found["bbox"])
                oriented = found.get("oriented") or none
                objects = []
                for name, (x, y, w, h), obb, own, counts in zip(
                    found["category"], found["bbox"], found.get("obb") or none, oriented,
                    found.get("segmentation") or none, strict=True,
                ):  # fmt: skip
                    corners = [obb[k : k + 2] for k in range(0, 8, 2)] if own else None
                    run_lengths = {"size": [row["height"], row["width"]], "counts": counts}
                    area = int(mask.area(run_lengths)) if counts else None
                    objects.append([name, x, y, x + w, y + h, corners, area])
                assert image.size == (row["width"], row["height"])
                stem = Path(image.filename).stem
                name = {"validation": "val"}.get(split, split)
                loaded.append({"split": name, "stem": stem, "size_wh": list(image.size), "objects": objects})
    return loaded


def shards_with_datasets(folder: Path) -> list[dict[str, Any]]:
    """Return packed shards loaded by the builders `webdataset` and `parquet`, which must agree."""
    import tempfile

    import datasets
    from pycocotools import mask

    datasets.disable_progress_bars()
    loaded = []
    with tempfile.TemporaryDirectory() as cache:
        tars, tables = (sorted(map(str, folder.glob(f"*.{end}"))) for end in ("tar", "parquet"))
        frames = datasets.load_dataset("webdataset", data_files={"train": tars}, cache_dir=cache)["train"]
        rows = datasets.load_dataset("parquet", data_files={"train": tables}, cache_dir=cache)["train"]
        assert [f["__key__"] for f in frames] == [r["key"] for r in rows]
        for frame, row in zip(frames, rows, strict=True):
            label, objects = frame["json"], []
            for one, same in zip(label["objects"], row["objects"], strict=True):
                assert one["box_xyxy"] == same["box_xyxy"]
                area = int(mask.area(one["mask"])) if one["mask"] else None
                assert (one["mask"] or {}).get("counts") == same["mask"]
                objects.append([one["category"], *one["box_xyxy"], one["corners_xy"], area])
            size = list(frame["jpg"].size)
            assert size == [row["width"], row["height"]]
            stem = Path(label["file_name"]).stem
            loaded.append({"split": row["split"], "stem": stem, "size_wh": size, "objects": objects})
    return loaded


def main(arguments: list[str]) -> int:
    """Load and print; see the module's text."""
    tools = {"supervision": with_supervision, "datumaro": with_datumaro, "datasets": with_datasets}
    if len(arguments) != 3 or arguments[0] not in tools:
        print(__doc__, file=sys.stderr)
        return 2
    tool, format_, folder = arguments
    try:
        loaded = tools[tool](format_, Path(folder))
    except KeyError:
        return 2
    json.dump(sorted(loaded, key=lambda i: (i["split"], i["stem"])), sys.stdout)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
