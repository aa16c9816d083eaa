"""Made-up flights: frames of the virtual world in the files of a camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from infrablend.core.rng import stream
from infrablend.formats.cameras.header_facts import read_facts
from infrablend.formats.cameras.raw_temperatures import read_temperatures
from infrablend.lab.world.frame_files import DJI_SCALE, camera_file, sample_world
from infrablend.lab.world.rjpeg_writing import MAKERS, Maker
from infrablend.lab.world.setting import FOCAL_PX
from infrablend.lab.world.world_frames import plan_frames


@pytest.mark.parametrize("maker", MAKERS)
def test_a_frame_holds_its_camera_and_its_temperatures(maker: Maker, tmp_path: Path) -> None:
    frame = plan_frames(2, 0, maker)[1]
    plan = sample_world(stream(0, "plan"), frame.pitch_deg, frame.altitude_m, frame.time_of_day)
    w, h = plan.camera.size_wh
    kelvin = np.linspace(265.0, 305.0, w * h, dtype=np.float32).reshape(h, w)
    path = tmp_path / frame.name
    path.write_bytes(camera_file(frame, plan, kelvin, np.full((h, w), 90, np.uint8), stream(0, "counts")))
    facts, raw = read_facts(path), read_temperatures(path)
    assert not facts.problems and facts.value("pitch_deg") == frame.pitch_deg
    assert facts.value("altitude_m") == pytest.approx(frame.altitude_m, abs=0.01)
    hfov = facts.value("hfov_deg")
    assert hfov is not None and w / 2 / np.tan(np.radians(hfov / 2)) == pytest.approx(FOCAL_PX, rel=0.005)
    found = DJI_SCALE.kelvin(raw.counts) if maker == "dji" else raw.apparent_k
    assert found is not None and np.abs(found - kelvin).mean() < 0.05
    assert raw.camera is None or raw.camera.settings.air_k == pytest.approx(plan.air_k, abs=1e-3)
