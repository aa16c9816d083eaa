"""The virtual world as a 16-bit flight in centikelvin, with a stand-in for Blender."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend import api
from infrablend.formats import dataset_folder
from infrablend.formats.pictures.images import load_background
from infrablend.lab.world.frame_files import FinishedFrame, Label, make_frame
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.world_dataset import WorldRequest, write_world
from infrablend.lab.world.world_frames import FrameFacts
from tests.run_files import records


class EvenGround:
    """Renders ground of 290 K with a warm band, without labels."""

    def render(self, plan: WorldPlan) -> tuple[NDArray[np.float32], list[Label]]:
        """Return the temperatures of a frame."""
        width, height = plan.camera.size_wh
        kelvin = np.full((height, width), 290, np.float32)
        kelvin[200:260] = 310
        return kelvin, []


def even_frames(frames: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
    for frame in frames:
        yield make_frame(frame, 3, EvenGround(), folder)


def test_the_radiometric_world_states_its_scale_air_and_camera(tmp_path: Path) -> None:
    write_world(tmp_path / "flight", WorldRequest(3, 3, "radiometric"), even_frames)
    dataset = dataset_folder.read(tmp_path / "flight")
    assert len(dataset.images) == 3
    for image in dataset.images:
        assert (
            image.capture.radiometry is not None
            and image.capture.radiometry.scale is not None
            and image.capture.radiometry.air_k
        )
        assert image.capture.pitch_deg is not None and image.capture.altitude_m is not None
        kelvin = image.capture.radiometry.scale.kelvin(load_background(image.path).pixels)
        assert abs(kelvin[:150].mean() - 290) < 0.01 and abs(kelvin[220:240].mean() - 310) < 0.01
        assert 0.04 < kelvin[:150].std() < 0.06


def test_the_air_in_the_metadata_goes_before_that_of_the_recipe(tmp_path: Path) -> None:
    write_world(tmp_path / "flight", WorldRequest(1, 3, "radiometric"), even_frames)
    (image,) = dataset_folder.read(tmp_path / "flight").images
    settings = {"matching.mode": "radiometric", "camera.calibrate": False, "placement.min_contrast": "off"}
    execution = api.Execution(renderer="flat", in_process=True)
    out = tmp_path / "run"
    report = api.generate("hit-uav-person", tmp_path / "flight", out, settings=settings, execution=execution)
    assert "air-drawn" not in {p.code for p in report.problems}
    (record,) = records(out)
    assert record.facts["matching"]["air"] == "metadata"
    assert image.capture.radiometry is not None and record.scene is not None and record.scene.weather is not None
    assert record.scene.weather.air_k == image.capture.radiometry.air_k


def test_tight_boxes_of_the_radiometric_world_are_no_fault(tmp_path: Path) -> None:
    class Turned(EvenGround):
        def render(self, plan: WorldPlan) -> tuple[NDArray[np.float32], list[Label]]:
            corners = np.array([[130.0, 100.0], [160.0, 130.0], [130.0, 160.0], [100.0, 130.0]])
            return super().render(plan)[0], [Label("Car", np.array([105.0, 105.0, 155.0, 155.0]), corners, 1.0, False)]

    def turned(frames: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
        for frame in frames:
            yield make_frame(frame, 3, Turned(), folder)

    write_world(tmp_path / "flight", WorldRequest(1, 3, "radiometric"), turned)
    assert len(dataset_folder.read(tmp_path / "flight").images[0].instances) == 1
    assert api.check(tmp_path / "flight").problems == ()
