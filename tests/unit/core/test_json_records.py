"""JSON files of any size: the values are those of `json.loads`, and faults name the file, the record and the limit."""

from __future__ import annotations

import json
import os
import tracemalloc
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from infrablend.core import json_records
from infrablend.core.json_records import JsonList, JsonTable, depth, is_list, is_table, open_json, open_rows
from infrablend.errors import DatasetError


def plain(value: Any) -> Any:
    """Return a value with everything that is still in the file."""
    if isinstance(value, JsonTable):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, JsonList):
        return [plain(v) for v in value]
    return {key: plain(v) for key, v in value.items()} if isinstance(value, dict) else value


def same(a: Any, b: Any) -> bool:
    return repr(a) == repr(b)  # NaN equals NaN


@pytest.fixture(autouse=True)
def tiny_pieces(monkeypatch):
    """Read a few characters at a time, and keep no list in memory."""
    monkeypatch.setattr(json_records, "_CHUNK", 5)
    monkeypatch.setattr(json_records, "_SHORT", 4)


leaves = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
    | st.sampled_from(["\ud800", "\u2028", "😀", '"', "\\", "a\0b", 10**300, -1e-320, float("-inf")])
)  # fmt: skip
values = st.recursive(
    leaves, lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner, max_size=5)
)


@pytest.mark.parametrize("reading", [open_json, open_rows])
@settings(max_examples=100, deadline=None)
@given(
    value=values,
    escaped=st.booleans(),
    indent=st.sampled_from([None, 0, 3]),
    mark=st.booleans(),
    chunk=st.integers(1, 40),
)
def test_values_are_those_of_json(tmp_path_factory, reading, value, escaped, indent, mark, chunk):
    json_records._CHUNK = chunk  # the fixture restores it
    path = tmp_path_factory.mktemp("a") / "a.json"
    text = json.dumps(value, ensure_ascii=escaped or "\\ud800" in json.dumps(value), indent=indent)
    path.write_bytes(b"\xef\xbb\xbf" * mark + text.encode())
    assert same(plain(reading(path)), json.loads(text))


@settings(max_examples=200, deadline=None)
@given(value=values, data=st.data())
def test_damaged_text_is_refused_like_by_json(tmp_path_factory, value, data):
    text = json.dumps({"a": [value], "b": value})
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 3)) | st.just(len(text)))
    text = text[:start] + data.draw(st.text('[]{}",:0-.eE+ntfN\\ud8x \n', max_size=4)) + text[end:]
    path = tmp_path_factory.mktemp("a") / "a.json"
    path.write_text(text)
    twice = False

    def note_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        nonlocal twice
        twice = twice or len(dict(pairs)) < len(pairs)
        return dict(pairs)

    try:
        expected = json.loads(text, object_pairs_hook=note_twice)
    except ValueError:
        with pytest.raises(DatasetError, match="not JSON"):
            open_json(path)
    else:
        if not twice:
            assert same(plain(open_json(path)), expected)


def test_lists_and_objects_stay_in_the_file(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"rows": [{"a": 1}, [2], "ä"], "few": [1], "info": {"x": [1, 2, 3]}}')
    top = open_json(path)
    assert isinstance(top["rows"], JsonList) and is_list(top["rows"]) and len(top["rows"]) == 3
    assert list(top["rows"]) == list(top["rows"]) == [{"a": 1}, [2], "ä"]
    assert (top["few"], top["info"]) == ([1], {"x": [1, 2, 3]})
    rows = open_rows(path)
    assert isinstance(rows, JsonTable) and is_table(rows) and len(rows) == 3
    assert [key for key, _ in rows.items()] == ["rows", "few", "info"]


LIMITED = [
    ('{"rows": [1, "%s"]}' % ("x" * 200), "rows[1]", "at most 0.0001 MB a record"),
    ("[" + "1, " * 30 + "[" + "0," * 99 + "0]]", "[30]", "at most 0.0001 MB a record"),
    ('{"a": {"k": "%s"}}' % ("x" * 200), 'a["k"]', "at most 0.0001 MB a record"),
    ('{"a": "%s' % ("x" * 1000), "in a", "at most 0.0001 MB a record"),
    ('{"a": [0.%s]}' % ("1" * 1000), "a[0]", "at most 0.0001 MB a record"),
    ("{" + ", ".join(f'"k{n}": {n}' for n in range(40)) + "}", "names and values", "at the top"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "where", "limit"), LIMITED)
def test_large_records_are_refused_by_name(tmp_path, monkeypatch, text, where, limit):
    monkeypatch.setattr(json_records, "MAX_RECORD", 100)
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(DatasetError) as caught:
        open_json(path)
    (problem,) = caught.value.problems
    assert (problem.where, problem.code) == ("a.json", "annotation-too-large")
    assert where in problem.found and limit in problem.expected


def test_a_record_of_the_largest_size_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(json_records, "MAX_RECORD", 100)
    path = tmp_path / "a.json"
    for size, fine in ((98, True), (99, False)):
        path.write_text(json.dumps(["x" * size] * 3))
        if fine:
            assert list(open_json(path)) == ["x" * size] * 3
        else:
            with pytest.raises(DatasetError, match=r"more than 0\.0001 MB"):
                open_json(path)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('{"rows": [1, 2', "not JSON (Expecting ',' delimiter at byte 14, in rows[2])"),
        ('{"rows": [1, {"a": nul}]}', "not JSON (Expecting value at byte 19, in rows[1])"),
        ('{"rows": [1, {"a": "b', "not JSON (Unterminated string starting at byte 19, in rows[1])"),
        ("[ä", "not JSON (Expecting value at byte 1, in [0])"),
        ("[1]]", "not JSON (Extra data at byte 3)"),
        ('{"a": [1, 2, 3, 4], "a" 5}', "not JSON (Expecting ':' delimiter at byte 24, in [\"a\"])"),
        ('{"k": 1, "l": [1, 2], "k": 3}', "two members of one name"),
        ("[" * 70 + "]" * 70, "nested too deeply at byte 1, in [0]"),
        ("[" * 100_000, "nested too deeply"),
        ("[" + "1" * 5000 + "]", "Exceeds the limit (4300"),
    ],
)
def test_faults_name_the_place(tmp_path, monkeypatch, text, found):
    monkeypatch.setattr(json_records, "MAX_RECORD", 10_000 if len(text) > 40 else 30)
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(DatasetError) as caught:
        open_rows(path) if "two members" in found else open_json(path)
    (problem,) = caught.value.problems
    assert problem.code == "annotation-not-json"
    assert found in problem.found
    assert str(path) in str(caught.value)


def test_bytes_that_are_not_utf_8(tmp_path):
    path = tmp_path / "a.json"
    for data in (b'["aaaaaaaaaaaaaaaaaaaaaaa\xff"]', b'["aaaaaaaa\xe2\x82'):
        path.write_bytes(data)
        with pytest.raises(DatasetError, match=r"not JSON \(not UTF-8"):
            open_json(path)


def test_members_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(json_records, "MAX_KEYS", 10)
    path = tmp_path / "a.json"
    path.write_text(json.dumps({str(n): n for n in range(11)}))
    with pytest.raises(DatasetError, match="more than 10 members"):
        open_rows(path)
    path.write_text(json.dumps(list(range(11))))
    assert len(open_rows(path)) == 11


def test_depth_counts_the_levels_above_a_record(tmp_path):
    path = tmp_path / "a.json"
    for levels in range(60, 68):
        text = '{"a": ' + "[" * (levels - 1) + "]" * (levels - 1) + "}"
        path.write_text(text)
        assert depth(json.loads(text)) == min(levels, 65)
        if levels <= 64:
            assert same(plain(open_json(path)), json.loads(text))
        else:
            with pytest.raises(DatasetError, match="nested"):
                open_json(path)


def test_a_file_that_was_changed_or_removed_is_not_read_on(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("[1, 2, 3, 4]")
    rows = open_json(path)
    path.write_text("[1, 2, 3, 4, 5]")
    os.utime(path, ns=(1, 1))
    with pytest.raises(DatasetError, match="changed"):
        list(rows)
    assert list(open_json(path)) == [1, 2, 3, 4, 5]
    path.unlink()
    with pytest.raises(DatasetError, match="No such file"):
        list(rows)


def test_memory_does_not_grow_with_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(json_records, "_CHUNK", 4096)
    peaks = []
    for count in (2_000, 20_000):
        path = tmp_path / f"{count}.json"
        write_rows(path, count)
        tracemalloc.start()
        assert sum(row["id"] for row in open_json(path)["rows"]) == count * (count - 1) // 2
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0] < 100_000


def write_rows(path: Path, count: int) -> None:
    with path.open("w") as stream:
        stream.write('{"rows": [')
        for n in range(count):
            stream.write("," * bool(n) + json.dumps({"id": n, "bbox": [1.5, 2.5, 3.5, 4.5]}))
        stream.write("]}")
