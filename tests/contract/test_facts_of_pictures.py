"""What is known of a picture survives every command that writes pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.contract.test_round_trips import FACT
from tests.flights import shot
from tests.videos import write_srt, write_video

from infrablend import api
from infrablend.core.capture import FACTS
from infrablend.core.format_table import find_writer

FLAT = api.Execution(renderer="flat", in_process=True)
SETTINGS = ["configurations=1", "output.originals=true", "output.formats=[coco]"]
COUNT = 3


def known(number: int) -> dict[str, Any]:
    """All facts of a picture; those of one picture and its sequence differ."""
    return {**FACT, "captured": f"2021-01-31T08:30:{10 * number:02}+01:00", "frame": number, "time_s": 10.0 * number}


def convert(data: Path, out: Path) -> Path:
    api.convert(data, out, "coco")
    return out


def select(data: Path, out: Path) -> Path:
    api.convert(data, out, "yolo", selection=api.Selection(images=2))
    return out


def split(data: Path, out: Path) -> Path:
    api.split(data, out, api.SplitRule(by="gap"), to="coco")
    return out


def temperatures(data: Path, out: Path) -> Path:
    api.extract_temperatures(data, out)
    return out


def temperatures_and_convert(data: Path, out: Path) -> Path:
    return convert(temperatures(data, out.with_name("layers")), out)


def generate(data: Path, out: Path) -> Path:
    api.generate("hit-uav-people", data, out, settings=SETTINGS, execution=FLAT)
    return out


def generate_from_a_conversion(data: Path, out: Path) -> Path:
    return generate(convert(data, out.with_name("converted")), out)


def exclude(data: Path, out: Path) -> Path:
    api.exclude(generate(data, out), ["train/DJI_0002_T"], data=data)
    return out


def merge(data: Path, out: Path) -> Path:
    pytest.importorskip("pyarrow")
    shards = out.with_name("shards")
    settings = [*SETTINGS, "output.layout=shards"]
    for number in (1, 2):
        shard = api.ShardRequest(number, 2)
        request = api.RunRequest("hit-uav-people", data, shards, settings=settings, execution=FLAT, shard=shard)
        api.generate_shard(request)
    api.merge([shards], out)
    return out


def packed(data: Path, out: Path) -> Path:
    """The shards themselves, which can be read as a dataset."""
    merge(data, out)
    return out.with_name("shards")


COMMANDS: tuple[Callable[[Path, Path], Path], ...] = (
    convert, select, split, temperatures, temperatures_and_convert,
    generate, generate_from_a_conversion, exclude, merge, packed,
)  # fmt: skip


@pytest.mark.parametrize("source", ["table", "headers"])
@pytest.mark.parametrize("command", COMMANDS, ids=lambda c: c.__name__)
def test_every_fact_survives_every_command(command: Callable[[Path, Path], Path], source: str, tmp_path: Path) -> None:
    data = tmp_path / "data"
    for n in range(COUNT):
        shot(data / f"DJI_{n + 1:04}_T.JPG", number=n, roll_deg=-7.5, yaw_deg=61.3)
    if source == "table":
        lines = [",".join(["file", *FACTS])]
        lines += [",".join([f"DJI_{n + 1:04}_T.JPG", *(str(known(n)[f]) for f in FACTS)]) for n in range(COUNT)]
        (data / "metadata.csv").write_text("\n".join(lines) + "\n")
    before = {str(i.capture.captured): i.capture.to_json() for i in api.read_dataset(data).images}
    assert len(before) == COUNT
    assert source == "headers" or all(facts.keys() == FACTS.keys() for facts in before.values())
    images = api.read_dataset(command(data, tmp_path / "out")).images
    assert images
    for image in images:
        assert image.capture.to_json() == before[str(image.capture.captured)]


def test_frames_of_a_video_keep_what_the_log_states(tmp_path: Path) -> None:
    pytest.importorskip("av")
    write_srt(
        tmp_path / "a.SRT",
        lambda n, s: (
            f"[rel_alt: 61.250 abs_alt: 9] [gb_yaw: 61.3 gb_pitch: -37.5 gb_roll: 7.5] [latitude: -1.4585] "
            f"[longitude: -48.4468]\n2021-01-31 08:30:{int(s):02}"
        ),
    )
    video = write_video(tmp_path / "a.mp4")
    api.extract_frames([video], tmp_path / "out", api.FrameChoice("1s"), api.FlightFacts(hfov_deg=33.0))
    facts = convert(tmp_path / "out", tmp_path / "coco")
    for image in api.read_dataset(facts).images:
        found = image.capture.to_json()
        assert FACTS.keys() - found.keys() == {"camera", "flight_yaw_deg"}
        for name in ("pitch_deg", "altitude_m", "hfov_deg", "latitude_deg", "longitude_deg", "yaw_deg"):
            assert found[name] == pytest.approx(FACT[name]), name


def test_a_format_holds_all_facts_or_lists_them() -> None:
    assert find_writer("coco").facts == find_writer("yolo").facts == frozenset(FACTS)
