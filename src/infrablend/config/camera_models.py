"""Lenses and detectors of thermal cameras, by the names that recipes use (`camera.model`).

Only cameras whose focal length and pixel pitch agree with a second statement of the maker: a field of view across the
picture, a 35 mm equivalent, or the header of a real picture. A wide lens that distorts, such as FLIR's 9 mm (69 degrees
across, where a lens without distortion has 62), is no pinhole, and left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from dataclasses import dataclass
from typing import Any, Literal, TypeGuard, cast

CameraModel = Literal[
    "autel-640t",
    "dji-h20t",
    "dji-m2ea",
    "dji-m30t",
    "dji-m3t",
    "dji-m4t",
    "dji-xt2-13",
    "dji-xt2-19",
    "dji-xt2-25",
    "flir-vue-pro-640-13",
    "flir-vue-pro-640-19",
    "skydio-x10",
]


@dataclass(frozen=True)
class Optics:
    """Lens and detector of a camera.

    Attributes:
        focal_length_mm: Focal length.
        pixel_pitch_um: Distance between the detector's pixels.
        columns: Pixels of the detector across; its pictures may have more, if the camera enlarges them.
        rows: Pixels of the detector from top to bottom.
    """

    focal_length_mm: float
    pixel_pitch_um: float
    columns: int = 640
    rows: int = 512

    @property
    def sensor_width_mm(self) -> float:
        """Width of the detector."""
        return round(self.pixel_pitch_um * self.columns / 1000, 6)


OPTICS: Mapping[CameraModel, Optics] = {
    # Autel EVO II Dual 640T (XT709) and its V3 (XL709): 13 mm, 12 um in Theta-Limited/DroneModels at 030dc28, which
    # states both values for both.
    "autel-640t": Optics(13.0, 12.0),
    # DJI, Zenmuse H20 series, specifications: 13.5 mm (equivalent 58 mm), 12 um, 40.6 degrees diagonal. EXIF: 13.5, 58.
    "dji-h20t": Optics(13.5, 12.0),
    # DJI, Mavic 2 Enterprise Advanced, specifications: 9 mm, 12 um. Theta-Limited/DroneModels at
    # 030dc28: 9.12 mm, 12 um. Measured on seven overlapping pictures: 44.3 degrees across, here 46.2.
    "dji-m2ea": Optics(9.0, 12.0),
    # DJI, Matrice 30 series, specifications: 9.1 mm (equivalent 40 mm), 12 um. EXIF: 9.1, 40. With infrared
    # super-resolution, pictures of 1280x1024 pixels show what the 640x512 of the detector see.
    "dji-m30t": Optics(9.1, 12.0),
    # DJI, Mavic 3 Enterprise series, specifications: equivalent 40 mm, 12 um; ground sampling distance H/7.6 cm, H in
    # metres. EXIF: 9.1, 40.
    "dji-m3t": Optics(9.1, 12.0),
    # DJI, Matrice 4T. EXIF of a real picture: 12 mm, 52 mm on 640x512 pixels, so 12 um.
    "dji-m4t": Optics(12.0, 12.0),
    # DJI, Zenmuse XT2, specifications: 17 um; 13 mm 45 x 37 degrees, 19 mm 32 x 26, 25 mm 25 x 20. EXIF (19 mm): 19.
    "dji-xt2-13": Optics(13.0, 17.0),
    "dji-xt2-19": Optics(19.0, 17.0),
    "dji-xt2-25": Optics(25.0, 17.0),
    # FLIR, Vue Pro, data sheet: 13 mm 45 x 37 degrees, 19 mm 32 x 26, both 640x512; 17 um of its core.
    "flir-vue-pro-640-13": Optics(13.0, 17.0),
    "flir-vue-pro-640-19": Optics(19.0, 17.0),
    # Skydio, X10 RTK/PPK metadata overview: 13.6 mm, 12 um, 640x512; the 40 of its names are degrees diagonal.
    "skydio-x10": Optics(13.6, 12.0),
}

_BY_HEADER: Mapping[tuple[str, str], tuple[CameraModel, ...]] = {
    ("AUTEL", "XL709"): ("autel-640t",),
    ("AUTEL", "XT709"): ("autel-640t",),
    ("DJI", "FLIR"): ("dji-xt2-13", "dji-xt2-19", "dji-xt2-25"),
    ("DJI", "M2EA"): ("dji-m2ea",),
    ("DJI", "MAVIC2-ENTERPRISE-ADVANCED"): ("dji-m2ea",),
    ("DJI", "M30T"): ("dji-m30t",),
    ("DJI", "M3T"): ("dji-m3t",),
    ("DJI", "M4T"): ("dji-m4t",),
    ("DJI", "ZH20T"): ("dji-h20t",),
    **{("SKYDIO", f"VT300-{kind}_40{end}"): ("skydio-x10",) for kind in "LZ" for end in ("", "IR")},
}

LENS = frozenset({"model", "pixel_pitch_um", "focal_length_mm", "sensor_width_mm"})
"""Fields of a recipe's camera that state its lens."""


def models_of_header(make: str, model: str, size_wh: tuple[int, int]) -> tuple[CameraModel, ...]:
    """Return the cameras, one per lens that was sold, which a header's maker and model mean in a thermal picture.

    Pictures of another shape than the detector, or with fewer pixels, are those of other cameras of the same drone.
    """
    names = _BY_HEADER.get((make.partition(" ")[0].upper(), model.upper()), ())
    return tuple(n for n in names if size_wh in ((OPTICS[n].columns * k, OPTICS[n].rows * k) for k in (1, 2)))


def with_optics(camera: Mapping[str, object]) -> dict[str, object]:
    """Return a camera's plain data with the focal length and sensor width that its model, or pixel pitch, gives.

    Raises:
        ValueError: The data state others, or both a model and a pitch.
    """
    found = dict(camera)
    model = found.get("model")
    pitch_um = found.get("pixel_pitch_um")
    size = found.get("size_px", (640, 512))
    width_px = size[0] if isinstance(size, list | tuple) and size else None
    given: dict[str, float] = {}
    if isinstance(model, str) and model in OPTICS:
        optics = OPTICS[cast(CameraModel, model)]
        given = {"focal_length_mm": optics.focal_length_mm, "sensor_width_mm": optics.sensor_width_mm}
    elif _is_number(pitch_um) and _is_number(width_px):
        given = {"sensor_width_mm": round(pitch_um * width_px / 1000, 6)}
    if model is not None and pitch_um is not None:
        raise ValueError("found both model and pixel_pitch_um")
    for name, value in given.items():
        other = found.get(name, value)
        if _is_number(other) and not math.isclose(other, value, rel_tol=1e-6):
            source = f"model {model}" if model is not None else f"pixel_pitch_um {pitch_um:g} on {width_px} pixels"
            raise ValueError(f"found {name} {other:g}, but {source} gives {value:g}")
        found[name] = value
    return found


def prefer_stated_optics(camera: dict[str, object], stated: Set[str]) -> str | None:
    """Remove from a camera what its recipe's file says of the lens and the `stated` settings replace.

    Returns:
        What is missing in the settings; None if nothing is.
    """
    if "model" in stated:
        for name in LENS - stated:
            camera.pop(name, None)
        return None
    of_detector = camera.get("model") is not None or (
        camera.get("pixel_pitch_um") is not None and "pixel_pitch_um" not in stated
    )
    if stated & LENS and isinstance(model := camera.pop("model", None), str):
        # What the settings leave open stays that of the model in the file.
        camera.update({k: v for k, v in with_optics({"model": model}).items() if k in LENS - stated - {"model"}})
    if stated & {"pixel_pitch_um", "size_px"} and camera.get("pixel_pitch_um") is not None:
        for name in {"sensor_width_mm"} - stated:
            camera.pop(name, None)
    if "sensor_width_mm" in stated and "pixel_pitch_um" not in stated:
        camera.pop("pixel_pitch_um", None)
    if "pixel_pitch_um" in stated and not ("focal_length_mm" in stated or of_detector):
        return "camera.focal_length_mm, the focal length printed on the lens"
    return None


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
