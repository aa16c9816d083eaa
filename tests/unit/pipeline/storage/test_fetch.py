"""`fetch` from a local server into a folder: its content, its record, and what it refuses."""

from __future__ import annotations

import hashlib
import json
import shutil
import zipfile
from pathlib import Path

import pytest

from infrablend import api
from infrablend.cli import main
from infrablend.cli.output import fetch_line
from infrablend.core.workspace import partial_of, workspace
from infrablend.errors import DatasetError, FetchError, InfraBlendError, OutputError
from infrablend.formats.published import sources
from infrablend.formats.published.sources import CC_BY_4, HIT_UAV, Archive, Source
from infrablend.pipeline.storage import fetch as fetching
from infrablend.pipeline.storage.fetch import FetchProgress
from tests.samples import SAMPLES
from tests.unit.pipeline.storage.server import BODY, tree, zip_entry, zipped

COMMIT = "f" * 40
CONTENT = {
    "LICENSE": b"licence text",
    "images/a.jpg": BODY[:9000],
    "images/b.jpg": BODY[9000:20000],
    "labels.json": b'{"annotations": [1, 2, 3]}',
}


def archive_of(content: dict[str, bytes], wrapper: str = "repo-ffff/", comment: str = COMMIT) -> bytes:
    return zipped({wrapper + n: c for n, c in content.items()}, comment.encode())


@pytest.fixture
def tiny(server, monkeypatch) -> Source:
    """A dataset of one archive on the server, one of two parts, one by hand, instead of the real ones."""
    one = Archive(
        "all", "tiny.zip", f"{server.url}/tiny.zip", commit=COMMIT,
        counts={"images/*.jpg": 2, "LICENSE": 1}, lists={"labels.json": {"annotations": 3}},
    )  # fmt: skip
    source = Source("tiny", "Tiny", "https://example.org/tiny", CC_BY_4, "A. Author", "@misc{tiny}", (one,))
    parts = tuple(
        Archive(
            p, f"{p}.zip", f"{server.url}/{p}.zip", into=f"Real{p}", counts={"*.csv": 1}, size_bytes=1, checked=False
        )
        for p in ("train", "test")
    )
    two = Source("two", "Two", "https://example.org/two", CC_BY_4, "B. Author", "@misc{two}", parts)
    by_hand = (Archive("all", "hand.zip"),)
    hand = Source(
        "hand", "Hand", "https://example.org/hand", sources.UNKNOWN, "C", "@misc{c}", by_hand, "None.", "Click there."
    )
    monkeypatch.setattr(sources, "SOURCES", (source, two, hand))
    monkeypatch.setattr(fetching, "SOURCES", (source, two, hand))
    server.files["/tiny.zip"] = archive_of(CONTENT)
    for p in ("train", "test"):  # folders doubled, and litter of another system beside them
        server.files[f"/{p}.zip"] = zipped(
            {f"R{p}/R{p}/s.csv": b"1,2", f"R{p}/R{p}/images/x.jpg": b"x", f"R{p}/.DS_Store": b"", "__MACOSX/x": b""}
        )
    return source


def fetch(name: str, out: Path, on_progress=None, **options):
    return fetching.fetch(name, out, fetching.FetchRequest(**options), on_progress=on_progress)


def test_fetch_from_end_to_end(tiny, server, tmp_path):
    seen: list[FetchProgress] = []
    out = tmp_path / "deep" / "tiny"
    report = fetch("tiny", out, on_progress=seen.append)
    found = tree(out)
    record = json.loads(found.pop("SOURCE.json"))
    assert found == CONTENT
    assert sorted(p.name for p in out.iterdir()) == ["LICENSE", "SOURCE.json", "images", "labels.json"]
    assert (report.fetched, report.present, report.files, report.problems) == (("all",), (), 4, ())
    data = server.files["/tiny.zip"]
    facts = record["archives"]["all"]
    assert facts["sha256"] == hashlib.sha256(data).hexdigest()
    assert (facts["size_bytes"], facts["url"], facts["commit"]) == (len(data), f"{server.url}/tiny.zip", COMMIT)
    assert record["licence"] == {"id": "cc-by-4.0", "name": "CC BY 4.0", "url": CC_BY_4.url}
    assert (record["name"], record["attribution"], record["citation"]) == ("tiny", "A. Author", "@misc{tiny}")
    assert {p.step for p in seen} == {"download", "unpack"}
    assert (seen[-1].done, seen[-1].total) == (4, 4)
    # Again: nothing is asked of the server.
    asked = len(server.requests)
    again = fetch("tiny", out)
    assert (again.fetched, again.present) == ((), ("all",))
    assert len(server.requests) == asked


def test_a_fetch_that_ends_early_leaves_nothing(tiny, server, tmp_path):
    for step in ("download", "unpack"):

        def stop(p: FetchProgress, step: str = step) -> None:
            if p.step == step:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            fetch("tiny", tmp_path / "out", on_progress=stop)
        assert list(tmp_path.iterdir()) == []
    for body in (server.files["/tiny.zip"][:-100], zip_entry("../../escaped")):
        server.files["/tiny.zip"] = body
        with pytest.raises(DatasetError, match=r"tiny\.zip"):
            fetch("tiny", tmp_path / "out")
        assert list(tmp_path.iterdir()) == []


def test_a_fetch_that_was_killed_before_its_folder_got_its_name_is_finished(tiny, tmp_path, monkeypatch):
    out = tmp_path / "out"
    rename = Path.rename

    def killed(self: Path, target: Path) -> Path:
        if self == partial_of(out):
            raise KeyboardInterrupt
        return rename(self, target)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, "rename", killed)
        fetch("tiny", out)
    assert not out.exists() and partial_of(out).exists()
    assert fetch("tiny", out).present == ("all",)
    assert {k: v for k, v in tree(out).items() if k != "SOURCE.json"} == CONTENT
    assert list(tmp_path.iterdir()) == [out]


def test_parts_doubled_folders_and_litter(tiny, server, tmp_path):
    out = tmp_path / "two"
    report = fetch("two", out, parts=["test"])
    assert sorted(n for n in tree(out)) == ["Realtest/images/x.jpg", "Realtest/s.csv", "SOURCE.json"]
    assert [p.code for p in report.problems] == ["size"]
    assert report.problems[0].severity == "warning"
    server.acts = [("status", 404)]
    before = tree(out)
    with pytest.raises(FetchError):
        fetch("two", out)
    assert tree(out) == before
    report = fetch("two", out)
    assert (report.fetched, report.present) == (("train",), ("test",))
    assert (out / "Realtrain" / "s.csv").read_bytes() == (out / "Realtest" / "s.csv").read_bytes() == b"1,2"
    record = json.loads((out / "SOURCE.json").read_text())
    assert sorted(record["archives"]) == ["test", "train"]
    # A part that was removed is fetched again.
    shutil.rmtree(out / "Realtest")
    assert fetch("two", out).fetched == ("test",)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["two"]


def test_wrong_content_is_refused(tiny, server, tmp_path):
    out = tmp_path / "tiny"
    less = {k: v for k, v in CONTENT.items() if k != "images/b.jpg"} | {"labels.json": b'{"annotations": [1]}'}
    server.files["/tiny.zip"] = archive_of(less, comment="e" * 40)
    with pytest.raises(DatasetError, match="does not contain the known files of tiny") as caught:
        fetch("tiny", out)
    assert [(p.code, p.found) for p in caught.value.problems] == [
        ("commit", f"made from commit {'e' * 40}"),
        ("content-files", "1 file(s)"),
        ("content-json", "1 items in 'annotations'"),
    ]
    assert not out.exists()
    server.files["/tiny.zip"] = archive_of(CONTENT)
    fetch("tiny", out)
    # The user's own address may serve something else, which is reported.
    server.files["/own.zip"] = archive_of(less)
    report = fetch("tiny", tmp_path / "own", url=f"{server.url}/own.zip")
    assert [p.code for p in report.problems] == ["content-files", "content-json"]
    assert json.loads((tmp_path / "own" / "SOURCE.json").read_text())["archives"]["all"]["differs"]


def test_checksums(tiny, server, tmp_path):
    right = hashlib.sha256(server.files["/tiny.zip"]).hexdigest()
    fetch("tiny", tmp_path / "a", sha256=right.upper())
    with pytest.raises(DatasetError, match="not the expected file") as caught:
        fetch("tiny", tmp_path / "b", sha256="0" * 64)
    assert right in str(caught.value)
    with pytest.raises(DatasetError, match="64 hexadecimal digits"):
        fetch("tiny", tmp_path / "c", sha256="abc")


def test_nothing_is_overwritten(tiny, server, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="not empty and not a download"):
        fetch("tiny", out)
    (out / "mine.txt").unlink()
    fetch("two", out, parts=["train"])
    (out / "Realtest").mkdir()
    (out / "Realtest" / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"not part of the download \(Realtest\)"):
        fetch("two", out)
    with pytest.raises(OutputError, match="holds two"):
        fetch("tiny", out)
    assert (out / "Realtest" / "mine.txt").read_text() == "mine"
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="is a file"):
        fetch("tiny", tmp_path / "file")
    server.files["/tiny.zip"] = archive_of({**CONTENT, "SOURCE.json": b"{}"})
    with pytest.raises(DatasetError, match="a name that `fetch` needs"):
        fetch("tiny", tmp_path / "new")
    # What is left of a part stays as it is.
    fetch("hand", tmp_path / "hand", archive=by_hand(tmp_path))
    (tmp_path / "hand" / "1.jpg").unlink()
    with pytest.raises(OutputError, match=r"2\.jpg: exists already"):
        fetch("hand", tmp_path / "hand", archive=by_hand(tmp_path))
    assert (tmp_path / "hand" / "2.jpg").exists()


def test_two_fetches_at_once(tiny, tmp_path):
    with (
        workspace(tmp_path / "out", "download", "SOURCE.json"),
        pytest.raises(OutputError, match="another process is writing this download"),
    ):
        fetch("tiny", tmp_path / "out")


def test_lack_of_disk_space_is_detected_before_the_download(tiny, server, tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda path: type("U", (), {"free": 1000})())
    with pytest.raises(OutputError, match="not enough disk space"):
        fetch("tiny", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def by_hand(folder: Path) -> Path:
    file = folder / "download (1).zip"
    file.write_bytes(zipped({"x/1.jpg": b"x", "x/2.jpg": b"y"}))
    return file


def test_keep_archive_and_archive_by_hand(tiny, server, tmp_path):
    fetch("tiny", tmp_path / "a", keep_archive=True)
    assert (tmp_path / "a" / "tiny.zip").read_bytes() == server.files["/tiny.zip"]
    asked = len(server.requests)
    report = fetch("hand", tmp_path / "b", archive=by_hand(tmp_path))
    assert report.files == 2
    assert len(server.requests) == asked
    assert (tmp_path / "download (1).zip").exists()
    record = json.loads((tmp_path / "b" / "SOURCE.json").read_text())
    assert record["licence"]["id"] == "unknown"
    assert record["archives"]["all"]["file"] == "download (1).zip"
    with pytest.raises(DatasetError, match=r"(?s)nothing was fetched.*Click there.*--archive"):
        fetch("hand", tmp_path / "c")


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("nothing", {}, "expected one of tiny, two, hand"),
        ("two", {"parts": ["val"]}, "no part val; expected some of train, test"),
        ("two", {"url": "http://x/y"}, "with --part"),
        ("tiny", {"url": "http://x/y", "archive": Path("z")}, "exclude each other"),
        ("tiny", {"archive": Path("no-such-file.zip")}, "no such file"),
        ("tiny", {"url": "file:///etc/passwd"}, "expected http"),
    ],
)
def test_invalid_requests(tiny, tmp_path, name, options, says):
    with pytest.raises(InfraBlendError, match=says):
        fetch(name, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_the_command(tiny, server, tmp_path, capsys):
    log = ["--log", str(tmp_path / "log")]
    assert main([*log, "fetch", "--list"]) == 0
    assert "by hand, licence unknown" in capsys.readouterr().out
    assert main([*log, "fetch", "hand"]) == 0
    assert "Click there." in capsys.readouterr().out
    assert main([*log, "fetch", "hand", str(tmp_path / "x")]) == 2
    assert main([*log, "fetch"]) == 2
    capsys.readouterr()
    assert main([*log, "fetch", "tiny", str(tmp_path / "out"), "--json"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["fetched"] == ["all"]
    licence, download_line = shown.err.index("CC BY 4.0"), shown.err.index("tiny.zip: ")
    assert licence < download_line  # before anything is fetched
    server.acts = [("status", 403)]
    assert main([*log, "fetch", "two", str(tmp_path / "two"), "--part", "train"]) == 3
    assert "refuses access" in capsys.readouterr().err


def test_progress_lines():
    assert fetch_line(FetchProgress("unpack", "a.zip", 3, 9)) == "a.zip: 3 of 9 files unpacked"
    assert fetch_line(FetchProgress("download", "a.zip", 2**20, None)) == "a.zip: 1.0 MiB"
    assert fetch_line(FetchProgress("download", "a.zip", 2**20, 2**22)) == "a.zip: 1.0 MiB of 4.0 MiB"


def test_the_table_of_sources():
    assert [s.name for s in sources.SOURCES] == [
        "hit-uav", "birdsai", "monet", "wisard", "wit-uas", "dut-anti-uav", "bambi", "drone-vehicle", "anti-uav",
        "halmstad",
    ]  # fmt: skip
    for s in sources.SOURCES:
        fetched = [a.url for a in s.archives if a.url]
        assert all(u.startswith("https://") for u in fetched)
        assert bool(s.by_hand) != bool(fetched)
        assert s.citation.startswith("@")
        assert s.citation.count("{") == s.citation.count("}")
        assert len({a.part for a in s.archives}) == len(s.archives)
        assert s.name in api.describe_source(s.name)


@pytest.mark.slow
def test_hit_uav_as_it_is_known(server, tmp_path):
    """An archive of empty pictures with the real layout, numbers and commit passes; one picture less does not."""
    (known,) = HIT_UAV.archives
    entries = {"LICENSE": b"Attribution 4.0 International"}
    for pattern, n in known.counts.items():
        if "*" in pattern:
            entries |= {pattern.replace("*", f"{k:05}"): b"" for k in range(n)}
    for name, lists in known.lists.items():
        entries[name] = json.dumps({k: [0] * n for k, n in lists.items()}).encode()
    assert sum(n.endswith(".jpg") for n in entries) == 4 * 2898
    file = tmp_path / "a.zip"
    file.write_bytes(archive_of(entries, "HIT-UAV-Infrared-Thermal-Dataset-x/", known.commit))
    report = api.fetch("hit-uav", tmp_path / "out", api.FetchRequest(archive=file))
    assert report.problems == ()
    assert report.files == len(entries)
    del entries["normal_json/train/00007.jpg"]
    file.write_bytes(archive_of(entries, "HIT-UAV-Infrared-Thermal-Dataset-x/", known.commit))
    (problem,) = api.fetch("hit-uav", tmp_path / "less", api.FetchRequest(archive=file)).problems
    assert (problem.where, problem.found, problem.expected) == ("normal_json/train/*.jpg", "2028 file(s)", "2029")


def packed(folder, file):
    with zipfile.ZipFile(file, "w") as archive:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            archive.write(path, path.relative_to(folder))
    return file


def test_an_archive_of_another_dataset_is_refused(tmp_path):
    other = packed(SAMPLES["yolo:detect"](tmp_path / "yolo"), tmp_path / "mine.zip")
    shown = []
    with pytest.raises(DatasetError, match=r"mine.zip: not wit-uas") as error:
        fetch("wit-uas", tmp_path / "out", archive=other, on_progress=shown.append)
    (problem,) = error.value.problems
    assert "it is read as yolo" in problem.found and "licence" in problem.todo
    assert not (tmp_path / "out").exists() and {p.file for p in shown} == {"mine.zip"}


def test_a_part_of_another_dataset_is_a_warning(tmp_path):
    other = packed(SAMPLES["yolo:detect"](tmp_path / "yolo"), tmp_path / "mine.zip")
    (problem,) = fetch("monet", tmp_path / "out", parts=["val"], archive=other).problems
    assert (problem.code, problem.severity) == ("not-this-format", "warning") and "monet" in problem.expected


def test_the_own_archive_of_a_dataset_is_accepted(tmp_path):
    own = packed(SAMPLES["wit-uas"](tmp_path / "wit"), tmp_path / "mine.zip")
    assert fetch("wit-uas", tmp_path / "out", archive=own).problems == ()
    assert api.read_dataset(tmp_path / "out").format == "wit-uas"
