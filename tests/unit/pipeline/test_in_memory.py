"""Frames in memory: the bytes of a run in any order, own code in workers, and a torch data set."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.core.dataset import Category, Instance
from infrablend.errors import ArgumentError, RecipeError
from tests.run_files import records

FLAT = api.Execution(renderer="flat", in_process=True)
POOL = api.Execution(renderer="flat", workers=2)
RECIPE = "hit-uav-drone"
FRAME = "test/0_130_90_0_00004_c1"
EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture
def data(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> Path:
    return write_tiny_hit_uav(tmp_path / "hit-uav")


def test_frames_have_the_pixels_labels_and_scenes_of_a_run(data: Path, tmp_path: Path) -> None:
    run, settings = tmp_path / "run", {"output.originals": True, "labels.loosen": 1.2}
    api.generate(RECIPE, data, run, settings=settings, execution=FLAT)
    with api.frames(RECIPE, data, settings=settings, execution=POOL) as frames:
        found = list(frames)
    assert tuple(f.id for f in found) == frames.ids
    written = {p.relative_to(run / "images").with_suffix("").as_posix(): p for p in (run / "images").rglob("*.jpg")}
    assert set(written) == set(frames.ids)
    labels = {f"{i.split}/{i.path.stem}": i.instances for i in api.read_dataset(run).images}
    for frame in found:
        assert frame.image_bytes == written[frame.id].read_bytes()
        assert (frame.pixels == np.asarray(Image.open(written[frame.id]).convert("L"))).all()
        assert [i.category for i in frame.labels] == [i.category for i in labels[frame.id]]
        boxes = np.array([i.box_xyxy for i in frame.labels]).reshape(-1, 4)
        assert np.allclose(boxes, np.array([i.box_xyxy for i in labels[frame.id]]).reshape(-1, 4), atol=1e-2)
        assert (frame.scene is None) == (not frame.id.endswith(("_c0", "_c1")))


def test_random_access_within_a_loop_and_after_leaving_it(data: Path) -> None:
    with api.frames(RECIPE, data, execution=POOL) as frames:
        alone = frames[FRAME].image_bytes
        for k, frame in enumerate(frames):
            assert frame.id == frames.ids[k]
            assert frames[FRAME].image_bytes == alone
            if k == 2:
                break
        assert [f.id for f in frames.iterate([FRAME, frames.ids[0], FRAME])] == [FRAME, frames.ids[0], FRAME]
        with pytest.raises(KeyError):
            _ = frames["test/none_c0"]
        with pytest.raises(ArgumentError, match="ids: found 'test/none_c0'"):
            frames.iterate(["test/none_c0"])


def test_another_seed_gives_other_objects_on_the_same_backgrounds(data: Path) -> None:
    with api.frames(RECIPE, data, execution=FLAT) as frames:
        (first,), (other,) = list(frames.iterate([FRAME])), list(frames.iterate([FRAME], seed=5))
        (again,) = frames.iterate([FRAME], seed=frames.seed)
    with api.frames(RECIPE, data, seed=5, execution=FLAT) as frames:
        assert frames[FRAME].image_bytes == other.image_bytes
    assert first.image_bytes == again.image_bytes != other.image_bytes


def test_a_broken_background_is_left_out_and_named(data: Path) -> None:
    for form in ("normal_json", "rotate_json"):
        (data / form / "test" / "0_130_90_0_00004.jpg").write_bytes(b"\xff\xd8 broken")
    with api.frames(RECIPE, data, execution=FLAT) as frames:
        found = [f.id for f in frames]
    assert not [i for i in found if i.startswith("test/")]
    assert "0_130_90_0_00004.jpg" in " ".join(str(p) for p in frames.problems)


def test_a_wrong_recipe_is_refused_before_any_frame(data: Path) -> None:
    with pytest.raises(RecipeError):
        api.frames(RECIPE, data, settings={"objects.0.cuont": 2}, execution=FLAT)


# ---- own code


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(EXAMPLES / "own_code"))
    import extensions

    yield extensions
    del sys.modules["extensions"]


def test_an_own_sampler_decides_what_is_in_the_scene(data: Path, own: Any) -> None:
    assert isinstance(own.OneObject(), api.SceneSampler)
    settings, extensions = {"objects.0.count": 4}, api.Extensions(sampler=own.OneObject())
    with api.frames(RECIPE, data, settings=settings, extensions=extensions, execution=POOL) as frames:
        assert {len(f.scene.objects) for f in frames if f.scene} == {1}


def test_an_own_look_changes_the_picture_and_not_the_labels(data: Path, own: Any) -> None:
    assert isinstance(own.DeadPixels(), api.Look)
    settings, look = {"output.image": "png"}, api.Extensions(look=own.DeadPixels(share=0.01))
    with api.frames(RECIPE, data, settings=settings, execution=FLAT) as frames:
        usual = frames[FRAME]
    with api.frames(RECIPE, data, settings=settings, extensions=look, execution=FLAT) as frames:
        worn = frames[FRAME]
    changed = usual.pixels != worn.pixels
    assert 0.005 < changed.mean() < 0.015
    assert (worn.pixels[changed] == 0).all()
    assert [i.to_json() for i in usual.labels][:1] == [i.to_json() for i in worn.labels][:1]


def test_own_backgrounds_need_no_files(own: Any) -> None:
    assert isinstance(own.Gradients(), api.BackgroundSource)
    with api.frames(RECIPE, own.Gradients(3), settings={"output.originals": True}, execution=POOL) as frames:
        found = {f.id: f for f in frames}
    assert len(found) == 9
    original = found["train/gradient_1"]
    assert (original.pixels == own.Gradients().load(original.image)).all()


class _Misfit:
    def apply(self, request: api.LookRequest) -> Any:
        return request.picture[1:].astype(np.float32)


def test_a_look_that_returns_something_else_is_refused(data: Path) -> None:
    extensions, message = api.Extensions(look=_Misfit()), r"look: returned \(511, 640\) float32, expected \(512, 640\)"
    with (
        api.frames(RECIPE, data, extensions=extensions, execution=FLAT) as frames,
        pytest.raises(ArgumentError, match=message),
    ):
        _ = frames[FRAME]


def test_classes_of_a_script_are_refused_with_what_to_do(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Misfit, "__module__", "__main__")
    with pytest.raises(ArgumentError, match="Move the class to a module of its own"):
        api.frames(RECIPE, data, extensions=api.Extensions(look=_Misfit()), execution=POOL)


# ---- torch


def test_a_torch_data_set_is_shuffled_resumed_and_new_in_every_epoch(data: Path) -> None:
    pytest.importorskip("torch")
    from infrablend.torch import InsertDataset

    request = api.FramesRequest(RECIPE, data, execution=FLAT)
    dataset = InsertDataset(request, transform=lambda frame: (frame.id, frame.image_bytes))
    first = list(dataset)
    assert len(first) == len(dataset) == 8
    dataset.set_epoch(1)
    second = list(dataset)
    assert sorted(i for i, _ in first) == sorted(i for i, _ in second)
    assert [i for i, _ in first] != [i for i, _ in second]
    assert not {pixels for _, pixels in first} & {pixels for _, pixels in second}
    with api.frames(RECIPE, data, execution=FLAT) as frames:
        assert {f.id: f.image_bytes for f in frames} == dict(first)

    dataset.set_epoch(1)
    passed = []
    for sample in dataset:
        passed.append(sample)
        if len(passed) == 3:
            state = dataset.state_dict()
            break
    resumed = InsertDataset(request, transform=lambda frame: (frame.id, frame.image_bytes))
    resumed.load_state_dict(state)
    assert passed + list(resumed) == second
    for opened in (dataset, resumed):
        opened.close()


def test_samples_become_lists_of_pictures_and_targets() -> None:
    from infrablend.torch import collate

    assert collate([("a", 1), ("b", 2)]) == (["a", "b"], [1, 2])
    assert collate([]) == ([], [])
    assert pickle.loads(pickle.dumps(collate)) is collate  # for a loader's workers


def test_no_class_is_the_background_of_detectors(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loss of torchvision's detectors: cross entropy with background as 0, and boxes of what is not background."""
    from infrablend import torch as ours

    fake = {"from_numpy": np.asarray, "tensor": np.array, "int64": np.int64, "bool": np.bool_}
    monkeypatch.setattr(ours, "torch", SimpleNamespace(**fake))
    categories = (Category(7, "Person"), Category(3, "Car"), Category(9, "DontCare", ignore=True))
    names = ("Car", "Person", "DontCare", "Car")
    labels = tuple(Instance(name, np.array([k, 0.0, k + 4, 8])) for k, name in enumerate(names))
    frame = SimpleNamespace(id="a", pixels=np.full((12, 16), 255, np.uint8), labels=labels)
    image, target = ours.to_tensors(frame, categories)
    assert image.shape == (1, 12, 16) and float(image.max()) == 1
    logits = np.full((3, len(categories) + 1), -9.0)
    for row, name in enumerate(n for n in names if n != "DontCare"):
        logits[row, 1 + [c.name for c in categories].index(name)] = 9  # a detector that knows all of them
    shares = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    assert -np.log(shares[np.arange(3), target["labels"]]).mean() < 1e-6
    assert target["boxes"][target["labels"] > 0].tolist() == [[0, 0, 4, 8], [1, 0, 5, 8], [3, 0, 7, 8]]


def test_a_loader_gives_batches(data: Path) -> None:
    torch_data = pytest.importorskip("torch.utils.data")
    from infrablend.torch import InsertDataset, collate

    dataset = InsertDataset(api.FramesRequest(RECIPE, data, execution=FLAT), shuffle=False)
    alone = list(dataset)
    for workers in (0, 2):
        loader = torch_data.DataLoader(dataset, batch_size=3, num_workers=workers, collate_fn=collate)
        batches = list(loader)
        assert all(len(images) == len(targets) <= 3 for images, targets in batches)
        together = {t["id"]: image for images, targets in batches for image, t in zip(images, targets, strict=True)}
        assert sorted(together) == sorted(t["id"] for _, t in alone)
        assert all((together[t["id"]] == image).all() for image, t in alone)
    dataset.close()


def test_the_workers_of_a_loader_share_the_frames(data: Path) -> None:
    torch_data = pytest.importorskip("torch.utils.data")
    from infrablend.torch import InsertDataset

    dataset = InsertDataset(api.FramesRequest(RECIPE, data, execution=FLAT))
    assert len(pickle.dumps(dataset)) < 10_000
    alone = {target["id"]: image for image, target in dataset}
    together = [(t["id"], image) for image, t in torch_data.DataLoader(dataset, batch_size=None, num_workers=2)]
    assert sorted(i for i, _ in together) == sorted(alone)
    assert all((image == alone[i]).all() for i, image in together)
    (image, target) = next(iter(dataset))
    assert image.shape == (1, 512, 640)
    assert 0 <= float(image.min()) <= float(image.max()) <= 1
    assert target["boxes"].shape == (len(target["labels"]), 4)
    dataset.close()


def test_another_camera_is_drawn_for_every_picture_and_repeats(data: Path, tmp_path: Path) -> None:
    plain = {"sensor.profile": "hit-uav", "output.originals": True, "output.image": "png"}
    settings = {**plain, "sensor.randomise": {"gain": [0.4, 0.6], "invert": 0.5, "noise_grey": [1, 4]}}
    api.generate(RECIPE, data, tmp_path / "plain", settings=plain, execution=FLAT)
    api.generate(RECIPE, data, tmp_path / "run", settings=settings, execution=FLAT)
    cameras = {r.frame_id: r.facts["camera"] for r in records(tmp_path / "run")}
    assert len({c["gain"] for c in cameras.values()}) == len(cameras) and {c["inverted"] for c in cameras.values()} == {
        True,
        False,
    }
    with api.frames(RECIPE, data, settings=settings, execution=POOL) as frames:
        for frame in frames:
            before, after = (np.asarray(Image.open(tmp_path / r / f"images/{frame.id}.png")) for r in ("plain", "run"))
            assert (frame.pixels == after).all()
            relation = np.corrcoef(before.ravel(), after.ravel())[0, 1] * after.std() / before.std()
            sign = -1 if cameras[frame.id]["inverted"] else 1
            assert relation * sign == pytest.approx(cameras[frame.id]["gain"], abs=0.1)
    again = api.rerender(tmp_path / "run", FRAME, tmp_path / "again.png")
    assert again.read_bytes() == (tmp_path / "run/images" / f"{FRAME}.png").read_bytes()
