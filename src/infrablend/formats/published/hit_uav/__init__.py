"""HIT-UAV (Suo et al. 2023): the four annotation forms of one set of pictures, read, united and written.

    normal_json/{train,val,test}/*.jpg   normal_json/annotations/{train,val,test}.json    axis-aligned, integers
    rotate_json/{train,val,test}/*.jpg   rotate_json/annotations/{train,val,test}.json    oriented, radians
    normal_xml/{Annotations,JPEGImages,ImageSets/Main}                                    VOC
    rotate_xml/{Annotations,JPEGImages,ImageSets/Main}                                    roLabelImg

Oriented boxes are `cx, cy, w, h, angle`: angle in radians in [0, pi], positive clockwise on screen, and w the side
along the angle. An axis-aligned box in a form with integers is that of the oriented box, truncated toward zero.

`reading` asks `label_forms` for what each form states (`form_records`), and `unite` merges the answers.
"""

from infrablend.formats.published.hit_uav.form_records import (
    CATEGORIES,
    FORMS,
    NAME,
    OPTIONS,
    TAKES_TABLE,
    Form,
    detect,
    find_forms,
)
from infrablend.formats.published.hit_uav.hit_uav_reading import read, remarks
from infrablend.formats.published.hit_uav.hit_uav_writing import native_writer, write

__all__ = [
    "CATEGORIES",
    "FORMS",
    "NAME",
    "OPTIONS",
    "TAKES_TABLE",
    "Form",
    "detect",
    "find_forms",
    "native_writer",
    "read",
    "remarks",
    "write",
]
