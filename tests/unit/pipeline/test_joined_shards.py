"""Packed shards joined into one without unpacking: the bytes of an undivided shard, and faults are named."""

import json
import shutil
import tarfile
from pathlib import Path

import pytest

from infrablend.formats import shard_tar
from infrablend.pipeline import merge, shard_source, shard_table, sharded_run
from infrablend.core.run_folder import sealed
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.killing import run_until_killed
from tests.unit.pipeline.test_run import dataset
from tests.unit.pipeline.test_shard_layout import PACKED, contents, names, shard_names
from tests.unit.pipeline.test_shards import command

pytest.importorskip("pyarrow.parquet")

__all__ = ["dataset"]


@pytest.fixture(autouse=True)
def flat(monkeypatch):
    render_flat(monkeypatch)


def marker(out: Path) -> dict[str, object]:
    """Record of the only shard, without what differs between equal runs."""
    record = json.loads((out / "shard-00001-of-00001.json").read_text())
    return {k: v for k, v in record.items() if k not in ("timing", "command")}


def test_joined_shards_have_the_bytes_of_an_undivided_one(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(shard_table, "_ROWS", 5)  # groups of rows that no shard ends with
    (dataset / "normal_json/train/1_80_90_0_00002.jpg").write_bytes(b"\xff\xd8\xff broken")
    assert run(*command(dataset, tmp_path / "whole", *PACKED)).exit_code == 1
    # More shards than frames: some are empty.
    run(*command(dataset, tmp_path / "parts", *PACKED, "--shard-size", 1))
    run(*command(dataset, tmp_path / "three", *PACKED, "--shard", "1/3"))
    for number in (2, 3):
        run(*command(dataset, tmp_path / "three", *PACKED, "--shard", f"{number}/3"))
    with monkeypatch.context() as patch:
        patch.setattr(merge, "can_join", lambda plan, shards: False)
        assert run("merge", tmp_path / "three", tmp_path / "unpacked", "--layout", "shards").exit_code == 1
    for name in ("parts", "three"):
        out = tmp_path / f"joined-{name}"
        with monkeypatch.context() as patch:
            patch.setattr(merge, "run_archived", None)
            ended = run("merge", tmp_path / name, out, "--layout", "shards", "--json")
        assert ended.exit_code == 1
        assert json.loads(ended.stdout)["counts"] == marker(out)["counts"]
        assert names(out) == [*shard_names(1, 1), "shards.json"]
        assert contents(out) == contents(tmp_path / "whole") == contents(tmp_path / "unpacked")
        assert marker(out) == marker(tmp_path / "unpacked")
        assert marker(out)["counts"] == marker(tmp_path / "whole")["counts"]
        assert marker(out)["counts"]["boxes_loosened"] == marker(out)["counts"]["objects_inserted"] > 0
        assert "shard 1/1: failed, 9 of 12 frames" in run("status", out).stdout
        assert run("check", out).exit_code == run("check", tmp_path / "whole").exit_code


def test_shards_that_do_not_count_changed_boxes_are_made_anew(dataset, tmp_path, monkeypatch):
    """Shards of earlier versions have no such count, and it must not become 0."""
    for number in (1, 2):
        run(*command(dataset, tmp_path / "parts", *PACKED, "--shard", f"{number}/2"))
    expected = merged_counts(tmp_path, "joined")
    assert expected["boxes_loosened"] == expected["objects_inserted"] > 0
    change_counts(tmp_path / "parts", lambda counts: counts.pop("boxes_loosened"))
    assert merged_counts(tmp_path, "older") == expected
    change_counts(tmp_path / "parts", lambda counts: counts.update(boxes_loosened=-3))
    ended = run("merge", tmp_path / "parts", tmp_path / "negative", "--layout", "shards")
    assert ended.exit_code != 0 and "boxes_loosened: -3 in its record" in " ".join(ended.output.split())


def merged_counts(tmp_path, name):
    ended = run("merge", tmp_path / "parts", tmp_path / name, "--layout", "shards", "--json")
    assert ended.exit_code == 0, ended.output
    return json.loads(ended.stdout)["counts"]


def change_counts(out, change):
    """Change the counts of all shards in a folder, with valid digests."""
    for path in sorted(out.glob("shard-*.json")):
        record = json.loads(path.read_text())
        change(record["counts"])
        path.write_text(json.dumps(sealed(record), indent=2))


def test_conversions_of_shards_name_their_source_and_recipe(dataset, tmp_path):
    """The records of shards are their only files beside the data: licence and authors were lost in conversions."""
    licence = "Attribution 4.0 International\n\nTerms of these pictures."
    (dataset / "LICENSE").write_text(licence)
    run(*command(dataset, tmp_path / "parts", *PACKED, "--shard-size", 5))
    run("merge", tmp_path / "parts", tmp_path / "joined", "--layout", "shards")
    sources = []
    for name in ("parts", "joined"):
        ended = run("convert", tmp_path / name, tmp_path / f"{name}-yolo", "--to", "yolo")
        assert ended.exit_code == 0, ended.output
        out = tmp_path / f"{name}-yolo"
        assert (out / "LICENSE-source.txt").read_text() == licence
        sources.append(json.loads((out / "SOURCE.json").read_text()))
        assert "license: cc-by-4.0" in (out / "README.md").read_text()
    assert sources[0] == sources[1]
    (inserts,) = sources[0]["inserts"]
    assert inserts["recipe"] and inserts["seed"] == 0 and sum(inserts["labels"].values()) > 0
    assert sources[0]["name"] == "hit-uav" and "Suo" in sources[0]["attribution"]


def test_a_part_of_the_shards(dataset, tmp_path, monkeypatch):
    for number in (1, 3):
        done(*command(dataset, tmp_path / "parts", *PACKED, "--shard", f"{number}/3"))
    words = ("merge", tmp_path / "parts", tmp_path / "joined", "--layout", "shards")
    ended = run(*words)
    assert ended.exit_code == 2
    assert "1 of 3 shards are not finished" in ended.output
    done(*words, "--partial")
    with monkeypatch.context() as patch:
        patch.setattr(merge, "can_join", lambda plan, shards: False)
        done("merge", tmp_path / "parts", tmp_path / "unpacked", "--layout", "shards", "--partial")
    assert contents(tmp_path / "joined") == contents(tmp_path / "unpacked")
    assert marker(tmp_path / "joined") == marker(tmp_path / "unpacked")


def test_existing_and_killed(dataset, tmp_path, monkeypatch):
    done(*command(dataset, tmp_path / "parts", *PACKED, "--limit", 2, "--shard-size", 2))
    out = tmp_path / "joined"
    words = ("merge", tmp_path / "parts", out, "--layout", "shards")
    done(*words)
    expected, times = contents(out), {p: p.stat().st_mtime_ns for p in out.iterdir()}
    ended = run(*words)
    assert ended.exit_code == 2
    assert "exists already" in ended.output
    done(*words, "--resume")
    assert {p: p.stat().st_mtime_ns for p in out.iterdir()} == times
    done(*words, "--overwrite")
    assert contents(out) == expected
    renamed, replace = [], Path.replace

    def noted(path: Path, target: Path) -> Path:
        renamed.append(target)
        return replace(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", noted)
        done(*words, "--overwrite")
    assert [p.suffix for p in renamed[-3:]] == [".tar", ".parquet", ".json"]
    for number in range(len(renamed)):
        shutil.rmtree(out)
        run_until_killed(number, lambda: run(*words))
        assert not (out / "shard-00001-of-00001.json").exists()
        done(*words, "--resume")
        assert contents(out) == expected
        assert names(out) == [*shard_names(1, 1), "shards.json"]


def test_shards_that_change_while_they_are_joined(dataset, tmp_path, monkeypatch):
    parts, out = tmp_path / "parts", tmp_path / "joined"
    done(*command(dataset, parts, *PACKED, "--limit", 2, "--shard-size", 2))
    for module in (shard_source, sharded_run):  # as if they changed after the check
        monkeypatch.setattr(module, "damage_of", lambda files, record, digests=True: None)
    tar, table = parts / "shard-00002-of-00003.tar", parts / "shard-00002-of-00003.parquet"
    data, rows = tar.read_bytes(), table.read_bytes()
    other = sorted(parts.glob("*.parquet"))[0].read_bytes()
    for damage, said in (
        (lambda: tar.write_bytes(data[:700] + b"?" + data[701:]), "another content"),
        (lambda: tar.write_bytes(data[:1000]), "another content"),
        (lambda: table.write_bytes(other), "in its table"),
        (lambda: table.write_bytes(rows[: len(rows) // 2]), "magic bytes"),
        (lambda: table.write_bytes(b""), "size is 0 bytes"),
    ):
        damage()
        ended = run("merge", parts, out, "--layout", "shards", "--resume")
        assert ended.exit_code in (2, 3), ended.output
        assert said in ended.output
        assert tar.stem in ended.output
        assert not list(out.glob("*.tar")) and not (out / "shard-00001-of-00001.json").exists()
        tar.write_bytes(data)
        table.write_bytes(rows)
    record_file = parts / "shard-00002-of-00003.json"
    text = record_file.read_text()
    record_file.write_text(text.replace('"objects_inserted":', '"objects_inserted_":'))
    ended = run("merge", parts, out, "--layout", "shards", "--resume")
    assert ended.exit_code == 2 and "objects_inserted: None in its record" in ended.output
    record_file.write_text(text)
    done("merge", parts, out, "--layout", "shards", "--resume")


def test_tars_with_long_names_and_without_files(tmp_path):
    def write(name: str, keys: list[str]) -> int:
        end = 0
        with (tmp_path / name).open("wb") as stream, shard_tar.TarWriter(stream) as tar:
            for key in keys:
                data = key.encode() * 37
                end = tar.add(key, "jpg", data) + len(data)
                for suffix in (shard_tar.LABEL, shard_tar.SCENE):
                    tar.add(key, suffix, b"\0" * len(key))  # zeros are content, too
        return end

    keys = ["test/a", "test/" + "b" * 180, "test/ü" * 20, "test/d"]
    write("whole", keys)
    parts = {"1": keys[:2], "2": [], "3": keys[2:3], "4": keys[3:]}
    seen = {name: write(name, part) for name, part in parts.items()}
    with (tmp_path / "joined").open("wb") as stream, shard_tar.TarWriter(stream) as tar:
        for name, end in seen.items():
            with (tmp_path / name).open("rb") as part:
                shift, _ = tar.add_files_of(part, end)
            if name == "4":
                assert shift > 0
    assert (tmp_path / "joined").read_bytes() == (tmp_path / "whole").read_bytes()
    with tarfile.open(tmp_path / "joined") as whole:
        assert len(whole.getmembers()) == 3 * len(keys)
