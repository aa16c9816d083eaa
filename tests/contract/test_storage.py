"""Runs in object storage: shards appear whole or not at all, and have the bytes of a local run."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.object_storage import BUSY, FORBIDDEN, Server, server, shorten_body
from tests.unit.pipeline.test_run import dataset, hashes
from tests.unit.pipeline.test_shards import command

from infrablend.core.run_folder import SHARDS_FILE

pytest.importorskip("pyarrow", reason="NEEDS PYARROW")

__all__ = ["dataset", "server"]

ROOT = Path(__file__).parents[2]
PACKED = ("--set", "output.layout=shards", "--limit", 2)
FIRST = [f"shard-00001-of-00002.{end}" for end in ("json", "parquet", "tar")]
SECOND = [f"shard-00002-of-00002.{end}" for end in ("json", "parquet", "tar")]


@pytest.fixture(autouse=True)
def quick(monkeypatch, tmp_path):
    render_flat(monkeypatch)
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))


def shard(data, server: Server, which: str, *words: object):
    return command(data, server.address, *PACKED, "--shard", which, *words)


def scratch_left() -> list[str]:
    return sorted(p.name for p in Path(os.environ["TMPDIR"]).glob("infrablend-*"))


def test_shards_in_a_bucket_merge_to_the_bytes_of_one_run(dataset, server, tmp_path):
    done(*command(dataset, tmp_path / "whole", "--limit", 2))
    ended = done(*shard(dataset, server, "1/2"))
    assert ended.output.rstrip().endswith(server.address)
    assert server.names() == [*FIRST, SHARDS_FILE]

    missing = run("status", server.address, "--json")
    assert missing.exit_code == 1
    second = json.loads(missing.stdout)["shards"][1]
    assert (second["state"], second["shard"]) == ("missing", "2/2")
    assert server.address in second["command"]
    assert "--shard 2/2" in second["command"]
    refused = run("merge", server.address, tmp_path / "merged")
    assert refused.exit_code == 2
    assert "1 of 2 shards are not finished" in refused.output

    again = run(*shard(dataset, server, "1/2"))
    assert again.exit_code == 2
    assert f"{server.address}/{FIRST[0]}: exists already" in again.output
    server.requests.clear()
    done(*shard(dataset, server, "1/2", "--resume"))
    assert not any(path.endswith((".tar", ".parquet")) for _, path in server.requests), "a whole shard is not read"

    done(*shard(dataset, server, "2/2"))
    assert server.names() == sorted([*FIRST, *SECOND, SHARDS_FILE])
    assert json.loads(done("status", server.address, "--json").stdout)["states"] == {"done": 2}
    done("merge", server.address, tmp_path / "merged")
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "whole")
    assert scratch_left() == []


def test_all_shards_at_once_and_beside_a_folder(dataset, server, tmp_path):
    done(*command(dataset, server.address, *PACKED, "--shard-size", 3))
    local = tmp_path / "local"
    done(*command(dataset, local, *PACKED, "--shard-size", 3))
    files = server.files()
    for path in sorted(local.glob("shard-*.*")):
        if path.suffix in (".tar", ".parquet"):
            assert files.cat_file(f"{server.bucket}/run/{path.name}") == path.read_bytes()
    # Shards of one run, some of them in a folder.
    files.rm_file(f"{server.bucket}/run/{SECOND[0]}".replace("of-00002", f"of-{len(list(local.glob('*.tar'))):05d}"))
    for path in local.glob("shard-*.json"):
        if "shard-00002" not in path.name:
            path.unlink()
    done("merge", server.address, local, tmp_path / "merged")
    done(*command(dataset, tmp_path / "whole", "--limit", 2))
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "whole")


def test_credentials_are_in_no_record_and_no_log(dataset, server, tmp_path, monkeypatch):
    log = tmp_path / "log.txt"
    monkeypatch.setenv("INFRABLEND_LOG", str(log))
    server.rule = lambda method, path, _: FORBIDDEN if method == "PUT" and path.endswith(".tar") else None
    assert run(*shard(dataset, server, "1/2")).exit_code == 3
    server.rule = None
    done(*shard(dataset, server, "1/2", "--resume"))
    files = server.files()
    texts = [files.cat_file(p) for p in files.find(f"{server.bucket}/run")]
    texts += [p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()]
    assert not any(secret in text for text in texts for secret in (b"very-secret-word", b"AKIATESTTESTTEST"))


@pytest.mark.parametrize("given", ["s3://key:geheim@b/run", "s3://b/run?key=geheim", "ftp://geheim@b/run", "s3://b"])
def test_addresses_that_are_refused(dataset, given):
    ended = run(*command(dataset, given, *PACKED))
    assert ended.exit_code == 2
    assert "out: found" in ended.output
    assert "geheim" not in ended.output


def test_files_need_a_folder(dataset, server):
    for words in ((), ("--plan",), ("--shard", "1/2")):
        # Nothing is copied for a command that cannot succeed.
        ended = run(*command(f"s3://{server.bucket}/data", server.address, "--limit", 2, *words))
        assert ended.exit_code == 2
        assert "--set output.layout=shards" in ended.output
    assert server.names() == []


def test_busy_and_slow_storage_is_ridden_out(dataset, server, tmp_path):
    seen: dict[str, int] = {}

    def busy(method, path, _):
        time.sleep(0.02)
        seen[method + path] = seen.get(method + path, 0) + 1
        return BUSY if seen[method + path] % 2 else None  # every second time

    server.rule = busy
    for which in ("1/2", "2/2"):
        done(*shard(dataset, server, which))
    done("merge", server.address, tmp_path / "merged")
    server.rule = None
    done(*command(dataset, tmp_path / "whole", "--limit", 2))
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "whole")


def test_storage_that_cannot_be_written(dataset, server, monkeypatch):
    from infrablend.rendering import flat

    server.rule = lambda method, path, _: FORBIDDEN if method in ("PUT", "POST") and ".tar" in path else None
    ended = run(*shard(dataset, server, "1/2"))
    assert ended.exit_code == 3, ended.output
    assert f"{server.address}/{FIRST[2]}: cannot be written" in ended.output
    assert server.names() == [SHARDS_FILE]
    assert run("status", server.address).exit_code == 1
    assert len(scratch_left()) == 1, "what was rendered is kept"
    server.rule = None
    server.requests.clear()
    monkeypatch.setattr(flat.FlatRenderer, "render", _fail)  # and copied: nothing is rendered again
    done(*shard(dataset, server, "1/2"))
    assert server.names() == [*FIRST, SHARDS_FILE]
    assert scratch_left() == []


@pytest.mark.parametrize("lie", ["swallow", "truncate"])
@pytest.mark.parametrize("name", [FIRST[2], FIRST[1], FIRST[0]])
def test_storage_that_lies_about_success(dataset, server, name, lie):
    def lying(method, path, environ):
        if method == "PUT" and path.endswith(name):
            if lie == "swallow":
                return "200 OK", ""
            shorten_body(environ, 100)
        return None

    server.rule = lying
    ended = run(*shard(dataset, server, "1/2"))
    assert ended.exit_code == 3, ended.output
    assert name in ended.output
    server.rule = None
    assert run("status", server.address).exit_code != 0
    if name != FIRST[0]:
        shown = run("status", server.address, "--json").stdout
        assert "done" not in json.loads(shown)["states"], shown
    done(*shard(dataset, server, "1/2", "--resume"))


@pytest.mark.parametrize("number", range(1, 9))
def test_a_killed_job_leaves_nothing_that_is_taken_for_a_shard(dataset, server, tmp_path, number):
    """Killed at each of its writes, before or after it arrived."""
    words = [str(w) for w in shard(dataset, server, "1/2")]
    program = (
        "from infrablend.cli import main; from infrablend.pipeline.plans.run_request import Execution; "
        "from tests.flat_renderer import flat_defaults; Execution.__init__.__defaults__ = flat_defaults(); main()"
    )
    left = [number]
    job = None

    def killing(method, path, _):
        if method in ("PUT", "DELETE"):
            left[0] -= 1
            if left[0] == 0:
                while job is None:
                    time.sleep(0.01)
                os.kill(job.pid, signal.SIGKILL)
                return BUSY if number % 2 else None
        return None

    server.rule = killing
    job = subprocess.Popen([sys.executable, "-c", program, "-q", *words], stdout=subprocess.DEVNULL, cwd=ROOT)
    code = job.wait()
    server.rule = None
    assert code in (0, -signal.SIGKILL), "the job failed before it was killed"
    if code == 0:
        assert left[0] > 0, "the job makes fewer writes"
    names = server.names()
    state = (
        json.loads(run("status", server.address, "--json").stdout)["shards"][0]["state"] if SHARDS_FILE in names else ""
    )
    assert (state == "done") == (FIRST[0] in names)
    done(*shard(dataset, server, "1/2", "--resume"))
    done(*shard(dataset, server, "2/2"))
    done("merge", server.address, tmp_path / "merged")
    done(*command(dataset, tmp_path / "whole", "--limit", 2))
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "whole")
    assert scratch_left() == []


def test_shards_of_another_run_are_refused(dataset, server):
    done(*shard(dataset, server, "1/2"))
    other = run(*shard(dataset, server, "2/2", "--seed", 5))
    assert other.exit_code == 2
    assert server.address in other.output
    assert "seed" in other.output
    assert "scratch" not in other.output
    assert server.names() == [*FIRST, SHARDS_FILE]


def test_a_finished_shard_of_another_run_is_not_taken_for_this_one(dataset, server):
    done(*shard(dataset, server, "1/2"))
    done(*shard(dataset, server, "2/2"))
    files = server.files()
    other = f"s3://{server.bucket}/other"
    done(*command(dataset, other, *PACKED, "--shard", "1/2", "--seed", 5))
    for name in FIRST:
        files.copy(f"{server.bucket}/other/{name}", f"{server.bucket}/run/{name}")
    ended = run(*shard(dataset, server, "1/2", "--resume"))
    assert ended.exit_code == 2, ended.output
    assert f"{server.address}/{FIRST[0]}: cannot be resumed" in ended.output
    assert "seed was 5, is 0" in ended.output
    done(*shard(dataset, server, "1/2", "--overwrite"))
    # Nor is another shard of this one.
    for ours, theirs in zip(FIRST, SECOND, strict=True):
        files.copy(f"{server.bucket}/run/{ours}", f"{server.bucket}/run/{theirs}")
    refused = run(*shard(dataset, server, "2/2", "--resume"))
    assert refused.exit_code == 0
    assert json.loads(files.cat_file(f"{server.bucket}/run/{SECOND[0]}"))["shard"] == "2/2"


def test_commands_name_the_address_where_the_shards_are_now(dataset, server):
    done(*shard(dataset, server, "1/2"))
    files = server.files()
    for name in (*FIRST, SHARDS_FILE):
        files.copy(f"{server.bucket}/run/{name}", f"{server.bucket}/moved/{name}")
    state = json.loads(run("status", f"s3://{server.bucket}/moved", "--json").stdout)["shards"][1]
    assert f"--out s3://{server.bucket}/moved " in state["command"]


@pytest.mark.parametrize(("name", "found"), [(FIRST[2], "has 50 bytes"), (FIRST[1], "has 50 bytes")])
def test_a_truncated_shard_is_named_and_made_again(dataset, server, tmp_path, name, found):
    done(*shard(dataset, server, "1/2"))
    done(*shard(dataset, server, "2/2"))
    server.files().pipe_file(f"{server.bucket}/run/{name}", b"x" * 50)
    state = json.loads(run("status", server.address, "--json").stdout)["shards"][0]
    assert state["state"] == "stopped"
    assert found in state["damage"]
    ended = run("merge", server.address, tmp_path / "merged")
    assert ended.exit_code == 2
    assert name in ended.output
    assert not (tmp_path / "merged").exists()
    done(*shard(dataset, server, "1/2", "--resume"))
    done("merge", server.address, tmp_path / "merged")


def test_a_tar_that_changed_at_its_size_is_refused(dataset, server, tmp_path):
    done(*command(dataset, server.address, *PACKED))
    path = f"{server.bucket}/run/shard-00001-of-00001.tar"
    files = server.files()
    data = bytearray(files.cat_file(path))
    data[1000] ^= 1
    files.pipe_file(path, bytes(data))
    ended = run("merge", server.address, tmp_path / "merged")
    assert ended.exit_code == 3
    assert "shard-00001-of-00001.tar: found" in ended.output
    assert not (tmp_path / "merged/run.json").exists() or "complete" not in (tmp_path / "merged/run.json").read_text()


def test_a_missing_bucket(dataset, server):
    ended = run(*command(dataset, "s3://no-such-bucket/run", *PACKED))
    assert ended.exit_code == 3
    assert "s3://no-such-bucket/run" in ended.output


def test_failed_frames_are_made_again(dataset, server, tmp_path, monkeypatch):
    from infrablend.rendering import flat

    real = flat.FlatRenderer.render
    monkeypatch.setattr(flat.FlatRenderer, "render", _fail)
    first = run(*shard(dataset, server, "1/2"))
    assert first.exit_code == 1, first.output
    assert json.loads(run("status", server.address, "--json").stdout)["shards"][0]["state"] == "failed"
    monkeypatch.setattr(flat.FlatRenderer, "render", real)
    done(*shard(dataset, server, "1/2", "--resume"))
    done(*shard(dataset, server, "2/2"))
    done("merge", server.address, tmp_path / "merged")
    done(*command(dataset, tmp_path / "whole", "--limit", 2))
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "whole")


def _fail(*args, **kwargs):
    raise RuntimeError("no light")


def test_a_dataset_in_a_bucket_is_read_as_one_in_a_folder(dataset, server, tmp_path):
    files = server.files()
    files.put(f"{dataset}/", f"{server.bucket}/data/", recursive=True)
    address = f"s3://{server.bucket}/data"
    done(*command(dataset, tmp_path / "local", "--limit", 2))
    done(*command(address, tmp_path / "run", "--limit", 2))
    ours, theirs = hashes(tmp_path / "run"), hashes(tmp_path / "local")
    differ = {name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name)}
    record = json.loads((tmp_path / "run/run.json").read_text())
    assert differ <= {"run.json", "report.html", "README.md"}
    assert record["data"]["root"] == address
    assert not any(b"cache/storage" in p.read_bytes() for p in (tmp_path / "run").rglob("*.json"))

    # It is copied once, and again when the storage lists other files.
    server.requests.clear()
    done(*command(address, server.address, *PACKED))
    assert not any(path.endswith(".jpg") for method, path in server.requests if method == "GET")
    done("merge", server.address, tmp_path / "merged")
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "run")
    picture = next(p for p in files.find(f"{server.bucket}/data") if p.endswith(".jpg"))
    files.pipe_file(picture, files.cat_file(next(p for p in files.find(f"{server.bucket}/data") if p > picture)))
    ended = run("merge", server.address, tmp_path / "again")
    assert ended.exit_code == 0  # a picture may change; labels and metadata may not


def test_names_of_folders_and_empty_files_in_a_bucket(dataset, server, tmp_path):
    files, data = server.files(), f"{server.bucket}/data"
    files.put(f"{dataset}/", f"{data}/", recursive=True)
    for name in ("", "normal_json/", "normal_json/train/", "empty/", "empty.txt", "files/ü '\".txt", "storage.json"):
        files.pipe_file(f"{data}/{name}", b"")
    address = f"s3://{data}"
    done(*command(address, tmp_path / "run", "--limit", 2))
    # A folder becomes a file and a file a folder.
    files.rm([f"{data}/files/ü '\".txt", f"{data}/empty.txt"])
    files.pipe_file(f"{data}/files", b"x")
    files.pipe_file(f"{data}/empty.txt/a", b"x")
    done(*command(address, tmp_path / "again", "--limit", 2))
    names = [sorted(p.name for p in root.iterdir()) for root in (tmp_path / "cache/storage").glob("*/data")]
    assert [".storage.json", "empty.txt", "files", "normal_json", "storage.json"] in names


def test_a_dataset_that_is_not_there(server, tmp_path):
    ended = run(*command(f"s3://{server.bucket}/nothing", tmp_path / "out"))
    assert ended.exit_code == 2
    assert "found no files, expected a dataset" in ended.output
