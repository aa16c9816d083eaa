"""Print image, class, box, visibility and mask area of each inserted object in a run."""

import json
import sys
from pathlib import Path

from pycocotools import mask


def main(run: Path) -> None:
    """Read every COCO file of the run."""
    for path in sorted((run / "coco").glob("*.json")):
        coco = json.loads(path.read_text())
        images = {i["id"]: i["file_name"] for i in coco["images"]}
        names = {c["id"]: c["name"] for c in coco["categories"]}
        for a in coco["annotations"]:
            if a["inserted"]:
                x, y, w, h = a["bbox"]
                pixels = int(mask.area(a["segmentation"]))
                where = f"x {x:.1f}, y {y:.1f}, {w:.1f} x {h:.1f} px"
                print(f"{images[a['image_id']]}: {names[a['category_id']]} at {where}, "
                      f"{a['visibility']:.0%} visible, mask of {pixels} px")  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1]))
