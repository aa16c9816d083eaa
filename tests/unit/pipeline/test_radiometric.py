"""Radiometric insertion without Blender: 16-bit pictures with a temperature scale, end to end."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from infrablend import api
from infrablend.assets.catalogue import load_model
from infrablend.compositing.radiometric import radiance_of, temperature_of
from infrablend.core.frame_row import FrameRecord
from infrablend.core.scene import SceneSpec
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.read_write import Reading
from tests.run_files import records

AIR_C = 12.0
_UM = np.linspace(8e-6, 14e-6, 2001)


def planck_band_radiance(kelvin: float) -> float:
    """Planck's law from 8 to 14 um, integrated by the trapezoidal rule: not the code under test."""
    h, c, k = 6.62607015e-34, 299_792_458.0, 1.380649e-23
    spectrum = 2 * h * c**2 / _UM**5 / np.expm1(h * c / (_UM * k * kelvin))
    return float((spectrum[1:] + spectrum[:-1]).sum() / 2 * (_UM[1] - _UM[0]))


def ground_k(seed: int) -> NDArray[np.float64]:
    """Smooth ground around 288 K with the noise of a camera."""
    rng = np.random.default_rng(seed)
    coarse = cv2.GaussianBlur(rng.normal(0, 1, (512, 640)), (0, 0), 60)
    return np.asarray(288 + 2 * coarse / coarse.std() + rng.normal(0, 0.05, (512, 640)))


def write_flight(root: Path, per_k: float = 100.0, offset_k: float = 0.0, suffix: str = ".tiff") -> Path:
    root.mkdir()
    rows = ["file,pitch_deg,altitude_m,time_of_day"]
    for k in range(2):
        counts = np.rint((ground_k(k) - offset_k) * per_k).astype(np.uint16)
        Image.fromarray(counts).save(root / f"{k}{suffix}")
        rows.append(f"{k}{suffix},60,25,night")
    (root / "metadata.csv").write_text("\n".join(rows) + "\n")
    return root


def settings(temperature_c: float, emissivity: float = 0.9, **more: Any) -> dict[str, Any]:
    """Cars of one temperature all over, with the air stated."""
    part = {"delta_t_k": [temperature_c - AIR_C] * 2, "emissivity": [emissivity] * 2}
    names = [n for n, p in load_model("car").parts.items() if p.label]
    return {
        "matching.mode": "radiometric",
        "data.unit": "centikelvin",
        "objects": [{"model": "car", "count": 1, "parts": dict.fromkeys(names, part)}],
        "camera.focal_length_mm": 13.0,
        "camera.sensor_width_mm": 7.68,
        "camera.calibrate": False,
        "environment.air_temperature_c": AIR_C,
        "placement.min_inside": 1.0,
        "placement.where": "anywhere",
        "placement.size_px": None,
        "sensor": {"profile": "off"},
        **more,
    }


def generate(data: Path, out: Path, fields: dict[str, Any]) -> list[FrameRecord]:
    execution = api.Execution(renderer="flat", in_process=True)
    api.generate("hit-uav-car", data, out, settings=fields, execution=execution, existing="overwrite")
    return records(out)


def pixels_of(path: Path) -> NDArray[np.uint16]:
    with Image.open(path) as picture:
        return np.array(picture).astype(np.uint16)


def core_of(record: FrameRecord) -> NDArray[np.bool_]:
    """Pixels that the car fills, as do their neighbours within the reach of the blur."""
    mask = record.inserted[0].mask
    assert mask is not None
    return np.asarray(cv2.erode(mask.to_array().astype(np.uint8), np.ones((9, 9), np.uint8)) > 0)


def apparent_k(scene: SceneSpec, temperature_k: float, emissivity: float, through: float) -> float:
    """Apparent temperature at the sensor, by formulas of the tests' own."""
    weather = scene.weather
    assert weather is not None
    own, mirrored, air = (planck_band_radiance(t) for t in (temperature_k, weather.ground_k, weather.air_k))
    at_sensor = through * (emissivity * own + (1 - emissivity) * mirrored) + (1 - through) * air
    low, high = 200.0, 500.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if planck_band_radiance(middle) < at_sensor else (low, middle)
    return low


def test_a_part_that_appears_at_324_kelvin_reads_32410_centikelvin(tmp_path: Path) -> None:
    data = write_flight(tmp_path / "data")
    first = generate(data, tmp_path / "run", settings(60.0))
    # Solve for the temperature that appears as 324.1 K in the first frame.
    facts = first[0].facts["matching"]
    low, high = 300.0, 360.0
    for _ in range(40):
        middle = (low + high) / 2
        found = apparent_k(first[0].scene, middle, 0.9, facts["transmittance"][0])
        low, high = (middle, high) if found < 324.1 else (low, middle)
    second = generate(data, tmp_path / "run", settings(low - 273.15))
    core, picture = core_of(second[0]), pixels_of(tmp_path / "run/images" / second[0].image)
    assert core.sum() > 100
    assert picture[core].min() >= 32_400 and picture[core].max() <= 32_420
    assert picture[core].mean() > pixels_of(data / "0.tiff").max() + 2_000  # far above all that the picture held


def test_a_sensor_changes_only_the_surroundings_has_the_noise_of_the_picture_and_is_recorded(tmp_path: Path) -> None:
    data = write_flight(tmp_path / "data")
    made = generate(data, tmp_path / "run", settings(60.0, sensor={"profile": "generic-640x512"}))
    again = api.rerender(tmp_path / "run", made[0].frame_id, tmp_path / "again.tiff")
    assert again.read_bytes() == (tmp_path / "run/images" / made[0].image).read_bytes()
    for r in made:
        assert 0.03 < (pixels_of(tmp_path / "run/images" / r.image)[core_of(r)] / 100).std() < 0.09  # kelvin
        assert r.facts["sensor"]["halo_gain"] == 0 and r.facts["sensor"]["limits"] is None
        # All other pixels are bit for bit those of the original.
        before, after = pixels_of(data / r.background["path"]), pixels_of(tmp_path / "run/images" / r.image)
        x0, y0, x1, y1 = r.inserted[0].box_xyxy
        rows, columns = np.nonzero(before != after)
        assert rows.size
        # The car, the reach of its blur, and the ground that a parked car warms.
        assert columns.min() >= x0 - 64 and columns.max() <= x1 + 64 and rows.min() >= y0 - 64 and rows.max() <= y1 + 64


@pytest.mark.parametrize(
    ("unit", "per_k", "offset_k"), [("decikelvin", 10.0, 0.0), ("counts", 25.0, 0.0), ("counts", 90.0, 230.0)]
)
def test_every_scale_gives_the_same_temperatures(tmp_path: Path, unit: str, per_k: float, offset_k: float) -> None:
    data = write_flight(tmp_path / "data", per_k, offset_k, ".png")
    scale = {"data.unit": unit} | ({} if unit == "decikelvin" else {"data.slope": 1 / per_k, "data.offset": offset_k})
    for r in generate(data, tmp_path / "run", settings(60.0, **scale)):
        expected = apparent_k(r.scene, 333.15, 0.9, r.facts["matching"]["transmittance"][0])
        found = pixels_of(tmp_path / "run/images" / r.image)[core_of(r)] / per_k + offset_k
        assert abs(found.mean() - expected) <= 0.1
        assert np.abs(found - expected).max() <= 0.5 / per_k + 0.01


def test_the_ground_is_that_of_the_picture_and_the_air_is_as_stated(tmp_path: Path) -> None:
    data = write_flight(tmp_path / "data")
    for r in generate(data, tmp_path / "run", settings(20.0)):
        facts, weather = r.facts["matching"], r.scene.weather
        assert (facts["air"], weather.air_k) == ("stated", pytest.approx(AIR_C + 273.15))
        assert weather.ground_k == pytest.approx(facts["ground_k"], abs=0.001)
        # The air in front of the ground, 3 K colder, takes some of its contrast: at its place it is warmer than here.
        assert 0 < weather.ground_k - facts["ring_k"][0] < 0.3


def test_air_that_nobody_stated_is_drawn_and_reported(tmp_path: Path) -> None:
    data = write_flight(tmp_path / "data")
    fields = settings(60.0, **{"environment.air_temperature_c": [5, 15]})
    execution = api.Execution(renderer="flat", in_process=True)
    report = api.generate("hit-uav-car", data, tmp_path / "run", settings=fields, execution=execution, limit=1)
    assert "air-drawn" in {p.code for p in report.problems}


def test_the_scale_is_in_the_labels_and_counted_as_lost_elsewhere(tmp_path: Path) -> None:
    data = write_flight(tmp_path / "data")
    generate(data, tmp_path / "run", settings(60.0, **{"output.formats": ["coco", "yolo"]}))
    again = dataset_folder.read(tmp_path / "run" / "coco")
    assert {
        i.capture.radiometry.scale.unit for i in again.images if i.capture.radiometry and i.capture.radiometry.scale
    } == {"centikelvin"}
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["losses"]["yolo.temperature_dropped"] == 2 and "coco.temperature_dropped" not in record["losses"]
    card = (tmp_path / "run" / "README.md").read_text()
    assert "centikelvin" in card


def test_pictures_without_a_scale_or_without_16_bits_are_named(tmp_path: Path) -> None:
    data = write_flight(tmp_path / "data")
    fields = settings(60.0)
    del fields["data.unit"]
    with pytest.raises(DatasetError) as caught:
        generate(data, tmp_path / "run", fields)
    assert {p.code for p in caught.value.problems if p.severity == "error"} == {"no-temperature-scale"}
    Image.fromarray(np.full((512, 640), 90, np.uint8)).save(data / "0.tiff")
    execution = api.Execution(renderer="flat", in_process=True)
    report = api.generate("hit-uav-car", data, tmp_path / "run", settings=settings(60.0), execution=execution)
    assert ("0.tiff", "image-no-temperatures") in [(p.where, p.code) for p in report.problems if p.severity == "error"]


def test_radiance_and_temperature_are_inverse_to_each_other() -> None:
    kelvin = np.array([233.15, 273.15, 300.0, 324.1, 420.0, 900.0])
    assert temperature_of(radiance_of(kelvin)) == pytest.approx(kelvin, abs=1e-9)
    own = [planck_band_radiance(float(t)) for t in kelvin]
    assert radiance_of(kelvin) == pytest.approx(own, rel=1e-4)


def test_reading_options_state_a_scale_too(tmp_path: Path) -> None:
    data = write_flight(tmp_path / "data")
    fields = settings(60.0)
    del fields["data.unit"]
    reading = Reading(options={"unit": "centikelvin"})
    planned = api.plan("hit-uav-car", data, settings=fields, reading=reading, execution=api.Execution(renderer="flat"))
    assert planned.to_json()["frames"] == 2


def test_the_8_bit_dataset_shows_originals_and_inserts_by_the_same_agc(tmp_path: Path) -> None:
    data = write_flight(tmp_path / "data")
    agc = {"mode": "fixed", "low_c": -10, "high_c": 70}
    formats = ["coco", "yolo", "voc"]
    fields = settings(60.0, **{"output.agc": agc, "output.formats": formats, "output.originals": True})
    (r, *_) = [r for r in generate(data, tmp_path / "run", fields) if r.scene is not None]
    made = tmp_path / "run" / "8bit"
    shown = {p.stem: pixels_of(p) for p in (made / "images" / "train").glob("*.png")}
    assert set(shown) == {"0", "0_c0", "1", "1_c0"}
    deep = pixels_of(tmp_path / "run/images" / r.image)
    expected = np.clip((deep / 100 - 273.15 + 10) / 80 * 255, 0, 255)
    assert np.abs(shown["0_c0"] - expected).max() <= 0.5 + 1e-6
    unchanged = deep == pixels_of(data / "0.tiff")
    assert (shown["0_c0"][unchanged] == shown["0"][unchanged]).all() and not unchanged.all()
    for name in formats:
        again = dataset_folder.read(made / name)
        assert len(again.images) == 4 and sum(len(i.instances) for i in again.images) == 2
        assert all(i.path.suffix == ".png" and i.capture.radiometry is None for i in again.images)
    assert "8bit/" in (tmp_path / "run" / "README.md").read_text()


def test_boxes_of_the_8_bit_dataset_are_not_enlarged_twice(tmp_path: Path) -> None:
    agc = {"mode": "fixed", "low_c": -10, "high_c": 70}
    fields = settings(60.0, **{"output.agc": agc, "output.formats": ["coco", "voc"], "labels.loosen": 1.2})
    generate(write_flight(tmp_path / "data"), tmp_path / "run", fields)
    for name in ("coco", "voc", "images"):
        with pytest.raises(DatasetError, match="enlarged or fitted already"):
            api.convert(tmp_path / "run" / "8bit" / name, tmp_path / "twice", "coco", loosen=1.1)


def test_a_fixed_agc_without_a_scale_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    data = write_flight(tmp_path / "data")
    fields = {"output.agc": {"mode": "fixed", "low_c": 0, "high_c": 40}}
    with pytest.raises(DatasetError, match="no usable background") as caught:
        api.generate("hit-uav-car", data, tmp_path / "run", settings=fields, execution=api.Execution(renderer="flat"))
    assert {p.code for p in caught.value.problems if p.severity == "error"} == {"no-temperature-scale"}
    assert not (tmp_path / "run").exists()
