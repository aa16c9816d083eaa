"""`models add`: what is guessed, what is asked for, and the description that is written; without Blender."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from infrablend.assets.catalogue import load_model
from infrablend.assets.user_model import geometry_file
from infrablend.errors import ArgumentError, ModelError
from infrablend.pipeline.plans.add_model import Axis, ModelAnswers, add_model, survey_model

PIECES = [("Body", "Grey"), ("Motor_1", "Grey"), ("Motor_2", "Grey"), ("Thing", "Grey"), ("Other", "Warm")]


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A 3D file whose geometry is already in the cache: one tetrahedron per piece, 2 x 1 x 1 units each."""
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "files" / "My quad (v2).glb"
    path.parent.mkdir()
    path.write_text("{}")  # glTF, as far as this test is concerned
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    facts: list[dict[str, object]] = [{"object": o, "material": m} for o, m in PIECES]
    facts[-1] |= {"temperature_c": 30.0, "emissivity": 0.9}  # an InfraredEffect material says what it is
    target = geometry_file(path)
    target.parent.mkdir(parents=True)
    n = len(PIECES)
    np.savez(
        target,
        vertices_m=np.concatenate([corners] * n),
        triangles=np.concatenate([faces + 4 * k for k in range(n)]).astype(np.int32),
        group_of_triangle=np.repeat(np.arange(n), 4).astype(np.int32),
        smooth=np.zeros(4 * n, bool),
        groups=np.array(json.dumps(facts)),
    )
    return path


def test_survey_lists_all_that_is_missing_at_once(file: Path) -> None:
    survey = survey_model(file, ModelAnswers())
    assert survey.guess.roles == ("shell", "motor", "motor", None, None)
    assert survey.file_size == (2.0, 1.0, 1.0)
    assert survey.unknown_parts == ["Thing"]
    with pytest.raises(ModelError, match="3 thing") as caught:
        add_model(file, None, ModelAnswers())
    text = "\n".join(map(str, caught.value.problems))
    for expected in ("--category NAME", "the file has 2 x 1 x 1 units", "--size-m METRES", "--part Thing=ROLE"):
        assert expected in text
    assert list(file.parent.iterdir()) == [file]


def test_written_description_loads_as_a_model(file: Path, tmp_path: Path) -> None:
    answers = ModelAnswers("drone", 0.5, {"Thing": "antenna"})
    path = add_model(file, tmp_path / "out", answers)
    assert path == tmp_path / "out" / "My-quad-v2.yaml"
    model = load_model(str(path))
    assert set(model.parts) == {"shell", "motor", "antenna", "Warm"}
    assert model.parts["motor"].delta_t_k == (10, 40)
    assert (model.category, model.stands) == ("drone", False)
    mesh = model.build(model.sample(np.random.default_rng(0), {}))
    # The front of a glTF is -Y in Blender and becomes +X.
    assert mesh.size_m == pytest.approx([0.25, 0.5, 0.25])
    with pytest.raises(ModelError, match="exists already; expected a new file"):
        add_model(file, tmp_path / "out", answers)


def test_a_description_that_does_not_load_is_removed(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(name: str) -> None:
        assert Path(name).is_file()
        raise ModelError("no volume")

    answers = ModelAnswers("drone", 0.5, {"Thing": "antenna"})
    with monkeypatch.context() as patch:
        patch.setattr("infrablend.pipeline.plans.add_model.ready_model", fail)
        with pytest.raises(ModelError, match="no volume"):
            add_model(file, tmp_path / "out", answers)
    assert list((tmp_path / "out").iterdir()) == []
    assert add_model(file, tmp_path / "out", answers).is_file()  # the same command, once the fault is mended


def test_animals_stand_on_the_ground(file: Path, tmp_path: Path) -> None:
    model = load_model(
        str(add_model(file, None, ModelAnswers("fox", 0.7, {"Thing": "eye", "Motor_1": "horn", "Motor_2": "horn"})))
    )
    assert model.stands
    assert model.parts["fur"].kind == "fur"
    assert (file.parent / "My-quad-v2.yaml").exists()


def box(file: Path, size: tuple[float, float, float]) -> None:
    """Scale the pieces of the imported file to this size (x, y, z), upright."""
    cached = geometry_file(file)
    with np.load(cached) as data:
        arrays = dict(data)
    arrays["vertices_m"] = arrays["vertices_m"] / (2.0, 1.0, 1.0) * size
    with cached.open("wb") as stream:
        np.savez(stream, **arrays)


@pytest.mark.parametrize(
    ("category", "size", "axis"),
    [
        ("deer", (1.6, 0.4, 1.3), ""),
        ("deer", (1.6, 1.3, 0.4), "z"),  # upright y is the file's z
        ("stag", (1.6, 1.3, 0.4), ""),  # nothing is known of its shape
        ("bird", (1.6, 1.3, 0.4), ""),
        ("person", (0.5, 0.3, 1.7), ""),
        ("person", (1.7, 0.3, 1.7), ""),  # arms stretched out
        ("person", (0.5, 1.7, 0.3), "z"),
        ("person", (1.7, 0.5, 0.3), "x"),
        ("car", (4.5, 1.8, 1.5), ""),
        ("car", (1.5, 1.8, 4.5), "x"),
        ("drone", (0.4, 0.4, 0.1), ""),
        ("drone", (0.1, 0.4, 0.7), "x"),
    ],
)
def test_a_model_that_seems_to_lie_on_its_side_is_a_warning(
    file: Path, caplog: pytest.LogCaptureFixture, category: str, size: tuple[float, float, float], axis: str
) -> None:
    box(file, size)
    parts = dict.fromkeys(("Body", "Motor_1", "Motor_2", "Thing"), "antenna")
    answers = ModelAnswers(category, 1.0, parts)
    doubts = survey_model(file, answers).doubts
    assert [p.severity for p in doubts] == ["warning"] * bool(axis)
    assert all(f"--up {axis}, or --up -{axis} if" in p.todo for p in doubts)
    if axis:
        with pytest.raises(ModelError, match="1 thing") as caught:
            add_model(file, None, replace(answers, size_m=None))
        assert doubts[0] in caught.value.problems
    add_model(file, None, answers)
    assert ("seems to lie on its side" in caplog.text) == bool(axis)
    assert survey_model(file, replace(answers, up="y")).doubts == []


@pytest.mark.parametrize(
    ("up", "size", "top"),
    [  # the upright x, y and z of the file are its x, -z and y
        ("y", (1.6, 1.3, 0.4), (0, 0, 1)),
        ("-y", (1.6, 1.3, 0.4), (0, 0, -1)),
        ("z", (1.6, 0.4, 1.3), (0, -1, 0)),
        ("-z", (1.6, 0.4, 1.3), (0, 1, 0)),
        ("x", (1.3, 0.4, 1.6), (1, 0, 0)),
        ("-x", (1.3, 0.4, 1.6), (-1, 0, 0)),
    ],
)
def test_the_axis_that_points_up_is_the_users(
    file: Path, up: Axis, size: tuple[float, float, float], top: tuple[int, int, int]
) -> None:
    box(file, (1.6, 1.3, 0.4))
    answers = ModelAnswers("drone", 1.6, {"Thing": "antenna"}, up)
    path = add_model(file, None, answers)
    assert f'up: "{up.upper()}"' in path.read_text()
    path.write_text(re.sub('heading: "[^"]*"', 'heading: "+X"', path.read_text()))
    model = load_model(str(path))
    mesh = model.build(model.sample(np.random.default_rng(0), {}))
    # Which sides are along x and y is a matter of heading.
    assert mesh.size_m[2] == pytest.approx(size[2]) and sorted(mesh.size_m) == pytest.approx(sorted(size))
    # The corner of a tetrahedron at the origin has neighbours along +x, +y and +z only.
    data = np.load(geometry_file(file))
    heights = np.asarray(data["vertices_m"]) @ top
    assert np.sort(mesh.vertices_m[:, 2] - mesh.vertices_m[:, 2].min()) == pytest.approx(
        np.sort(np.repeat((heights - heights.min())[:4], len(mesh.vertices_m) // 4))
    )
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0  # turned, not mirrored


def test_wrong_answers_are_named_together(file: Path) -> None:
    with pytest.raises(ModelError, match="3 answer") as caught:
        survey_model(file, ModelAnswers("drone", -1.0, {"Nothing": "motor", "Thing": "warmth"}))
    text = "\n".join(map(str, caught.value.problems))
    assert "--part Nothing=motor: no object or material has this name; expected one of Body, Grey, Motor_1" in text
    assert "--part Thing=warmth: unknown role; expected one of motor, battery" in text
    assert "--size-m -1" in text
    with pytest.raises(ArgumentError, match="up: found 'W', expected one of X, Y, Z, -X, -Y, -Z"):
        ModelAnswers(up="w")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match=r"unknown type; expected one of \.glb"):
        survey_model(file.with_suffix(".stl"), ModelAnswers())
