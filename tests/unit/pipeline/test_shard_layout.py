"""Shards as a tar and a table: what they contain, and that they merge to the bytes of an undivided run."""

import hashlib
import json
import os
import shlex
import shutil
import tarfile
import tracemalloc
from itertools import groupby
from pathlib import Path

import pytest

from infrablend import api
from infrablend.core.ledger import Ledger
from infrablend.core.workspace import Workspace, workspace
from infrablend.formats.labels import shard_tar
from infrablend.pipeline.runs import packed_shard
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.killing import run_until_killed
from tests.unit.pipeline.test_run import dataset, hashes
from tests.unit.pipeline.test_shards import command

pq = pytest.importorskip("pyarrow.parquet")

__all__ = ["dataset"]

PACKED = ("--set", "output.layout=shards")


@pytest.fixture(autouse=True)
def flat(monkeypatch):
    render_flat(monkeypatch)


@pytest.fixture
def small(dataset, tmp_path):
    """Command of a run in two packed shards, without the words that choose one."""
    return command(dataset, tmp_path / "out", *PACKED, "--limit", 2)


def contents(out: Path) -> dict[str, str]:
    """Digests of tars and tables, which do not depend on time and machine."""
    return {
        p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(out.glob("shard-*.*")) if p.suffix != ".json"
    }


def names(out: Path) -> list[str]:
    return sorted(p.name for p in out.iterdir())


def shard_names(number: int, count: int) -> list[str]:
    return [f"shard-{number:05d}-of-{count:05d}.{end}" for end in ("json", "parquet", "tar")]


def test_shards_of_both_layouts_merge_to_the_bytes_of_one_run(dataset, tmp_path):
    done(*command(dataset, tmp_path / "whole"))
    expected = hashes(tmp_path / "whole")
    packed, files = tmp_path / "packed", tmp_path / "files"
    for number in (3, 1):
        done(*command(dataset, packed, *PACKED, "--shard", f"{number}/3"))
    done(*command(dataset, files, "--shard", "2/3"))
    assert names(packed) == [*shard_names(1, 3), *shard_names(3, 3), "shards.json"]
    done("merge", packed, files, tmp_path / "merged")
    assert hashes(tmp_path / "merged") == expected
    assert json.loads((tmp_path / "whole/run.json").read_text())["levels"]

    # One packed shard of all of them has the bytes of an undivided packed run.
    done("merge", packed, files, tmp_path / "repacked", "--layout", "shards")
    done(*command(dataset, tmp_path / "one", *PACKED))
    assert contents(tmp_path / "repacked") == contents(tmp_path / "one")
    assert names(tmp_path / "repacked") == [*shard_names(1, 1), "shards.json"]
    done("merge", tmp_path / "repacked", tmp_path / "unpacked")
    assert hashes(tmp_path / "unpacked") == expected

    # Finished shards stay as they are, and the same frames give the same bytes.
    before = contents(packed)
    again = run(*command(dataset, packed, *PACKED, "--shard", "3/3"))
    assert again.exit_code == 2
    assert "exists already" in again.output
    times = {p: p.stat().st_mtime_ns for p in packed.iterdir()}
    done(*command(dataset, packed, *PACKED, "--shard", "3/3", "--resume"))
    assert {p: p.stat().st_mtime_ns for p in packed.iterdir()} == times
    done(*command(dataset, packed, *PACKED, "--shard", "3/3", "--overwrite"))
    assert contents(packed) == before
    mixed = run(*command(dataset, packed, "--shard", "2/3"))
    assert mixed.exit_code == 2
    assert "output.layout: shards, not files" in mixed.output


def test_contents_of_a_shard(dataset, tmp_path):
    done(*command(dataset, tmp_path / "whole"))
    whole = tmp_path / "whole"
    done(*command(dataset, tmp_path / "out", *PACKED))  # an undivided run is one shard
    assert names(tmp_path / "out") == [*shard_names(1, 1), "shards.json"]
    done("status", tmp_path / "out")
    tar_file = tmp_path / "out/shard-00001-of-00001.tar"
    with tarfile.open(tar_file) as tar:
        infos = tar.getmembers()
        data = {i.name: tar.extractfile(i).read() for i in infos}
    for info in infos:
        facts = (info.isreg(), info.mtime, info.uid, info.gid, info.uname, info.gname, info.mode)
        assert facts == (True, 0, 0, 0, "", "", 0o644)
    # WebDataset: files of a sample follow each other, and a key ends at the first dot of the name.
    keys = [key for key, _ in groupby(infos, lambda i: i.name.partition(".")[0])]
    assert len(keys) == len(set(keys)) == len(infos) // 3
    rows = pq.read_table(tmp_path / "out/shard-00001-of-00001.parquet").to_pylist()
    assert [r["key"] for r in rows] == keys == [r["frame_id"] for r in rows]
    coco = {s: json.loads((whole / "coco" / f"{s}.json").read_text()) for s in ("train", "val", "test")}
    for row in rows:
        suffix = Path(row["image"]).suffix
        assert data[row["key"] + suffix] == (whole / "images" / row["image"]).read_bytes()
        with Ledger.open(whole) as ledger:
            assert json.loads(data[row["key"] + ".scene.json"]) == json.loads(ledger.record_text(row["frame_id"]))
        found = tar_file.read_bytes()[row["image_offset"] :][: row["image_bytes"]]
        assert found == data[row["key"] + suffix]
        for column, name in (("image", suffix), ("label", ".json"), ("scene", ".scene.json")):
            assert row[f"{column}_sha256"] == hashlib.sha256(data[row["key"] + name]).hexdigest()
        # The labels are those of the label files, in the same order.
        part = coco[row["split"]]
        (image,) = [i for i in part["images"] if row["image"].endswith(i["file_name"])]
        boxes = [a["bbox"] for a in part["annotations"] if a["image_id"] == image["id"]]
        label = json.loads(data[row["key"] + ".json"])
        for objects in (row["objects"], label["objects"]):
            found = [o["box_xyxy"] for o in objects]
            assert [[x, y, r - x, b - y] for x, y, r, b in found] == [pytest.approx(b, abs=1e-6) for b in boxes]
        assert [o["category"] for o in row["objects"]] == [o["category"] for o in label["objects"]]
        assert row["draws"] is None or row["draws"]["attempts"] >= 1
    assert sum(len(r["objects"]) for r in rows) == sum(len(c["annotations"]) for c in coco.values()) > 0


def test_memory_is_flat_in_the_number_of_frames(tmp_path):
    def write_and_read(count: int) -> int:
        tracemalloc.start()
        with (tmp_path / "a.tar").open("wb") as stream, shard_tar.TarWriter(stream) as tar:
            for n in range(count):
                for suffix in ("jpg", "json", "scene.json"):
                    tar.add(f"test/{n}", suffix, b"x" * 100)
        assert sum(1 for _ in shard_tar.packed_frames(tmp_path / "a.tar")) == count
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    write_and_read(10)
    assert write_and_read(2000) < write_and_read(200) + 100_000


def test_keys_have_no_dot():
    assert shard_tar.key_of("test/a_c0") == "test/a_c0"
    assert shard_tar.key_of("test/v1.2/a.b%_c0") == "test/v1.2/a%2Eb%25_c0"


def test_all_shards_of_a_size(small, tmp_path):
    out = tmp_path / "out"
    ended = done(*small, "--shard-size", 2, "--json")
    count = len(list(out.glob("*.tar")))
    assert count > 1
    counts = json.loads(ended.stdout)["counts"]
    assert counts["frames"] == sum(pq.read_metadata(p).num_rows for p in out.glob("*.parquet"))
    assert counts["loosened_by"] == 1.2, "a factor is no count that is added"
    before = contents(out)
    shutil.rmtree(out)
    for number in range(1, count + 1):
        done(*small, "--shard", f"{number}/{count}")
    assert contents(out) == before


def test_a_kill_before_any_rename_is_finished(dataset, tmp_path, monkeypatch):
    out, renamed = tmp_path / "out", []
    words = command(dataset, out, *PACKED, "--limit", 1, "--shard", "1/2")
    replace = Path.replace

    def noted(path: Path, target: Path) -> Path:
        renamed.append(target)
        return replace(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", noted)
        done(*words)
    expected, listed = contents(out), names(out)
    assert [p.suffix for p in renamed[-3:]] == [".tar", ".parquet", ".json"] and renamed[-1].parent == out
    for number in range(len(renamed)):
        shutil.rmtree(out)
        run_until_killed(number, lambda: run(*words))
        # No marker: nothing counts as finished, and readers refuse it.
        assert not (out / "shard-00001-of-00002.json").exists()
        if (out / "shards.json").exists():
            assert run("check", out).exit_code == 2
            states = json.loads(run("status", out, "--json").stdout)["shards"]
            assert states[0]["state"] in ("stopped", "missing")
        done(*words, "--resume")
        assert contents(out) == expected
        # A kill may leave a temporary plan, which is hidden and has a name of its own.
        assert [name for name in names(out) if not name.startswith(".shards.")] == listed


def test_a_kill_after_the_record_leaves_no_frames_behind(small, tmp_path, monkeypatch):
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(Workspace, "discard", lambda self: os._exit(137))
        run_until_killed(10**6, lambda: run(*small, "--shard", "1/2"))
    left = out / ".shard-00001-of-00002.partial"
    assert left.is_dir()
    assert json.loads(run("status", out, "--json").stdout)["states"] == {"done": 1, "missing": 1}
    before = contents(out)
    done(*small, "--shard", "1/2", "--resume")
    assert contents(out) == before
    assert not left.exists()


def test_damaged_shards_are_named_and_made_again(small, tmp_path):
    out = tmp_path / "out"
    for number in (1, 2):
        done(*small, "--shard", f"{number}/2")
    expected = contents(out)
    tar, table = out / "shard-00002-of-00002.tar", out / "shard-00001-of-00002.parquet"
    data = tar.read_bytes()
    for damage, said in (
        (lambda: tar.write_bytes(data[:2000]), "tar has 2000 bytes"),
        (lambda: tar.write_bytes(data[:700] + b"?" + data[701:]), "tar was changed"),
        (tar.unlink, "tar is missing"),
        (table.unlink, "parquet is missing"),
    ):
        damage()
        ended = run("merge", out, tmp_path / "merged")
        assert ended.exit_code == 2
        assert said in " ".join(ended.output.split())
        assert not (tmp_path / "merged").exists()
        for number in (1, 2):
            done(*small, "--shard", f"{number}/2", "--resume")
        assert contents(out) == expected
    tar.write_bytes(data[:2000])
    ended = run("status", out)
    assert ended.exit_code == 1
    assert "shard 2/2: stopped, shard-00002-of-00002.tar has 2000 bytes" in ended.stdout
    # The command is known from other records where a shard's own is damaged.
    record = out / "shard-00001-of-00002.json"
    written = record.read_bytes()
    record.write_bytes(b"{}")
    states = {s.shard.number: s.command for s in api.status(out)}
    assert "--seed 0 --shard 1/2 --resume" in states[1] or "--limit 2 --shard 1/2 --resume" in states[1]
    record.write_bytes(written)


@pytest.mark.parametrize("layout", [(), PACKED])
def test_two_jobs_on_one_shard(layout, dataset, tmp_path):
    out, words = tmp_path / "out", command(dataset, tmp_path / "out", *layout, "--limit", 2)
    with workspace(out / "shard-00002-of-00002", "shard", "run.json"):
        ended = run(*words, "--shard", "2/2")
        assert ended.exit_code == 2 and "another process is writing this shard" in ended.output
        done(*words, "--shard", "1/2")  # others go on
        states = json.loads(run("status", out, "--json").stdout)["shards"]
        assert [s["state"] for s in states] == ["done", "running"]


def test_a_shard_under_the_name_of_another_one_is_not_merged(small, tmp_path):
    done(*small, "--shard", "1/2")
    for ours, theirs in zip(shard_names(1, 2), shard_names(2, 2), strict=True):
        shutil.copy(tmp_path / "out" / ours, tmp_path / "out" / theirs)
    assert "found shard 1/2" in run("merge", tmp_path / "out", tmp_path / "merged").output
    assert not (tmp_path / "merged").exists()


def test_a_finished_shard_of_another_run_is_not_taken_for_this_one(small, dataset, tmp_path):
    done(*small, "--shard", "1/2")
    done(*small, "--shard", "2/2")
    out, before = tmp_path / "out", contents(tmp_path / "out")
    done(*command(dataset, tmp_path / "other", *PACKED, "--limit", 2, "--seed", 5, "--shard", "1/2"))
    for name in shard_names(1, 2):
        shutil.copy(tmp_path / "other" / name, out / name)
    ended = run(*small, "--shard", "1/2", "--resume")
    assert ended.exit_code == 2, ended.output
    assert "seed was 5, is 0" in ended.output
    done(*small, "--shard", "1/2", "--overwrite")
    # Nor is another shard of this one.
    for ours, theirs in zip(shard_names(1, 2), shard_names(2, 2), strict=True):
        shutil.copy(out / ours, out / theirs)
    done(*small, "--shard", "2/2", "--resume")
    assert contents(out) == before


def test_failed_frames_are_tried_again(dataset, tmp_path):
    broken = dataset / "normal_json/train/1_80_90_0_00002.jpg"
    out, words = tmp_path / "out", command(dataset, tmp_path / "out", *PACKED)
    done(*words)
    expected, data = contents(out), broken.read_bytes()
    shutil.rmtree(out)
    broken.write_bytes(data[:3000])
    assert run(*words).exit_code == 1
    assert "shard 1/1: failed, 9 of 12 frames" in run("status", out).stdout
    assert run("merge", out, tmp_path / "merged").exit_code == 1
    whole = run(*command(dataset, tmp_path / "whole"))
    assert whole.exit_code == 1
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "whole")
    broken.write_bytes(data)
    for number in (0, 1, 4):
        run_until_killed(number, lambda: run(*words, "--resume"))
        assert run("status", out).exit_code == 1
    done(*words, "--resume")
    assert contents(out) == expected
    assert names(out) == [*shard_names(1, 1), "shards.json"]


def test_missing_pyarrow_is_named(small, tmp_path, monkeypatch):
    monkeypatch.setattr(packed_shard, "find_spec", lambda name: None)
    ended = run(*small)
    assert ended.exit_code != 0
    assert "infrablend[shards]" in ended.output
    assert not list((tmp_path / "out").glob("shard-*"))


def test_commands_read_shards(dataset, tmp_path):
    """The dataset in the tars is that of the merged run, and every command that reads datasets takes it."""
    out = tmp_path / "out"
    done(*command(dataset, out, *PACKED, "--shard-size", 7))
    done("merge", out, tmp_path / "merged")
    packed, merged = api.read_dataset(out), api.read_dataset(tmp_path / "merged")
    assert packed.format == "shards"
    classes = [[(c.id, c.name, c.ignore) for c in d.categories] for d in (packed, merged)]
    assert classes[0] == classes[1]
    assert [(i.split, i.name) for i in packed.images] == [(i.split, i.name) for i in merged.images]
    for a, b in zip(packed.images, merged.images, strict=True):
        assert a.path.read_bytes() == b.path.read_bytes()
        assert (a.id, a.size_wh, a.capture.pitch_deg, a.capture.time_of_day) == (
            b.id,
            b.size_wh,
            b.capture.pitch_deg,
            b.capture.time_of_day,
        )
        assert [(o.category, o.inserted) for o in a.instances] == [(o.category, o.inserted) for o in b.instances]
        for o, p in zip(a.instances, b.instances, strict=True):
            assert o.box_xyxy.tolist() == pytest.approx(p.box_xyxy.tolist(), abs=1e-6)
            assert o.mask == p.mask
    assert "out: shards, 12 images" in done("check", out).stdout
    done("inspect", out)
    assert "Merge the shards first" in run("exclude", out, "test/x").output
    for number, source in enumerate((out, tmp_path / "merged")):
        done("convert", source, tmp_path / f"coco{number}", "--to", "coco")
        done("split", source, tmp_path / f"split{number}", "--by", "gap", "--to", "yolo")
    folders = [tmp_path / "coco0", tmp_path / "coco1"]
    found = [sorted(p.relative_to(folder) for p in folder.rglob("*.json")) for folder in folders]
    assert found[0] == found[1]
    for name in (n for n in found[0] if n.stem in ("train", "val", "test")):
        first, second = (json.loads((folder / name).read_text()) for folder in folders)
        assert [a["bbox"] for a in first["annotations"]] == [a["bbox"] for a in second["annotations"]]
    pictures = [sorted((tmp_path / f"split{n}").rglob("*.jpg")) for n in (0, 1)]
    assert [p.read_bytes() for p in pictures[0]] == [p.read_bytes() for p in pictures[1]] != []


def test_readers_name_unfinished_and_damaged_shards(small, tmp_path):
    out = tmp_path / "out"
    done(*small, "--shard", "1/2")
    ended = run("check", out)
    assert ended.exit_code == 2
    assert "1 of 2 shards" in ended.output
    named = out.rename(tmp_path / "it's here")
    assert f"infrablend status {shlex.quote(str(named))};" in " ".join(run("check", named).output.split())
    named.rename(out)
    done(*small, "--shard", "2/2")
    done("check", out)
    tar = out / "shard-00002-of-00002.tar"
    data = tar.read_bytes()
    picture = data.index(b"\xff\xd8\xff") + 700  # within the first JPEG
    tar.write_bytes(data[:picture] + bytes([data[picture] ^ 1]) + data[picture + 1 :])
    ended = run("check", out)
    assert ended.exit_code == 1
    assert "file-changed" in ended.stdout
    assert "shard-00002-of-00002.tar was changed" in " ".join(ended.stdout.split())
    tar.write_bytes(data[:5000])
    for words in (("check", out), ("convert", out, tmp_path / "to", "--to", "coco")):
        ended = run(*words)
        assert ended.exit_code in (1, 2)
        assert "shard-truncated" in ended.output or "expected" in ended.output
        assert "shard-00002-of-00002.tar" in ended.output
    assert not (tmp_path / "to").exists()


def test_conversions_of_shards_name_their_source_and_recipe(dataset, tmp_path):
    """The records of shards are their only files beside the data: licence and authors were lost in conversions."""
    licence = "Attribution 4.0 International\n\nTerms of these pictures."
    (dataset / "LICENSE").write_text(licence)
    done(*command(dataset, tmp_path / "parts", *PACKED, "--shard-size", 5))
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
