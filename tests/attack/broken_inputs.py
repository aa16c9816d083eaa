"""Break inputs of every kind and give them to the commands that read them.

A command may succeed or end with an error that InfraBlend raises on purpose. It may not end in any other way, take
long, follow a path out of its folders, or lose labels without a word.
"""

from __future__ import annotations

import gzip
import io
import json
import random
import shutil
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from infrablend.config.sensor_profile import PROFILES
from infrablend.core.file_names import is_inside
from infrablend.core.workspace import partial_of
from infrablend.pipeline.runs.review_file import REVIEW_FILE
from tests.attack.child import TIMED_OUT, Outcome, fork_command
from tests.attack.findings import Finding
from tests.attack.models import choose_model, write_models
from tests.attack.scenarios import EXPERIMENT, PACKED, PLACE, Words, done, generate_words, new_lab, output, write_shards
from tests.attack.trees import contents, differences, snapshot
from tests.clips import write_clips, write_detections
from tests.fuzzing import WEIRD_JSON, WEIRD_WORDS, mutate
from tests.samples import SAMPLES

Choice = random.Random


@dataclass(frozen=True)
class Input:
    """One kind of input.

    Attributes:
        name: Name in the table.
        make: Writes intact inputs to the folder `in` of a lab.
        breaks: Breaks them, and returns what was done.
        words: Commands that read them.
        judge: Returns what else is wrong, such as lost labels.
        share: Share of the attempts.
    """

    name: str
    make: Callable[[Path], object]
    breaks: Callable[[Path, Choice], str]
    words: Callable[[Path], list[Words]]
    share: float
    judge: Callable[[Path, Outcome, dict[str, str]], str] = lambda lab, outcome, before: ""


# -- breaking


def _break_files(*parts: str) -> Callable[[Path, Choice], str]:
    """Return a breaker of one to four things below these folders of a lab."""

    def breaks(lab: Path, choose: Choice) -> str:
        roots = [lab / part for part in parts if (lab / part).is_dir()]
        return "; ".join(mutate(choose.choice(roots), lab / "canary", choose) for _ in range(choose.randint(1, 4)))

    return breaks


def _break_yaml(path: str) -> Callable[[Path, Choice], str]:
    """Return a breaker of a YAML file: of its values, or of its text."""

    def breaks(lab: Path, choose: Choice) -> str:
        file = lab / path
        if choose.random() < 0.3:
            return mutate(file.parent, lab / "canary", choose)
        top = yaml.safe_load(file.read_text())
        told = [break_value(top, choose) for _ in range(choose.randint(1, 3))]
        file.write_text(yaml.safe_dump(top, allow_unicode=True), "utf-8", errors="surrogatepass")
        return "; ".join(told)

    return breaks


def break_value(top: Any, choose: Choice) -> str:
    """Replace, delete or move one value in nested lists and mappings; return what was done."""
    places: list[tuple[Any, Any]] = []

    def walk(value: Any) -> None:
        pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, inner in list(pairs):
            places.append((value, key))
            walk(inner)

    walk(top)
    if not places:
        return "nothing left"
    holder, key = choose.choice(places)
    what = choose.randrange(5)
    if what == 0:
        del holder[key]
        return f"without {key!r}"
    if what == 1 and isinstance(holder, dict):
        holder[choose.choice([*WEIRD_WORDS, *holder])] = holder[key]
        return f"{key!r} under another name"
    if what == 2:
        other, name = choose.choice(places)
        holder[key] = json.loads(json.dumps(other[name], default=str)) if _has(other, name) else None
        return f"{key!r} from {name!r}"
    if what == 3 and isinstance(holder[key], int | float) and not isinstance(holder[key], bool):
        factor = choose.choice((-1, 0, 1e-9, 0.5, 1.5, 1000, 10**9))
        try:
            holder[key] = holder[key] * factor
        except OverflowError:  # a whole number that no float can hold
            holder[key] = -holder[key]
        return f"{key!r}: {holder[key]!r}"
    holder[key] = choose.choice([*WEIRD_JSON, *WEIRD_WORDS])
    return f"{key!r}: {str(holder[key])[:40]!r}"


def _has(holder: Any, key: Any) -> bool:
    return key in holder if isinstance(holder, dict) else isinstance(key, int) and key < len(holder)


_ENTRIES = (
    "../evil.txt", "/tmp/evil.txt", "a/../../evil.txt", "..\\evil.txt", "C:\\evil.txt", "a\0b", "x" * 300, "",
    ".", "con", "é\u0301", "a/" * 200 + "b", "SOURCE.json", ".fetch.json", "normal_json", "\udc80.txt", "a\nb",
)  # fmt: skip


def _break_archive(lab: Path, choose: Choice) -> str:
    """Break the archive: its bytes, its names, links in it, or what it claims about sizes."""
    file, source = lab / "in" / "data.zip", lab / "in" / "made"
    what = choose.randrange(4)
    if what == 0:
        data = bytearray(file.read_bytes())
        for _ in range(choose.randint(1, 30)):
            data[choose.randrange(len(data))] = choose.randrange(256)
        file.write_bytes(data[: choose.choice((len(data), len(data), choose.randrange(len(data))))])
        return "bytes"
    if what == 1:
        said = mutate(source, lab / "canary", choose)
    names = [choose.choice(_ENTRIES) for _ in range(choose.randint(0, 2))]
    paths = [p for p in sorted(source.rglob("*")) if p.is_file() and not p.is_symlink()]
    if what <= 2:
        with zipfile.ZipFile(file, "w", choose.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
            for path in paths:
                archive.write(path, path.relative_to(source))
            for name in names:
                with_name = zipfile.ZipInfo("x")
                with_name.filename = name
                if choose.random() < 0.3:
                    with_name.external_attr = 0o120777 << 16
                if name.isprintable():
                    archive.writestr(with_name, choose.choice((b"/etc/passwd", b"../../canary", b"", b"\0" * 10**6)))
        return f"zip with {names}" if what == 2 else said
    with io.BytesIO() as stream:
        with tarfile.open(fileobj=stream, mode="w") as tar:
            for path in paths:
                tar.add(path, path.relative_to(source))
            for name in names:
                entry = tarfile.TarInfo(name.replace("\0", "") or "x")
                entry.type = choose.choice((tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE, tarfile.CHRTYPE, b"0"))
                entry.linkname = choose.choice(("/etc/passwd", "../../canary/mine.txt", ".", name.replace("\0", "")))
                entry.mode = choose.choice((0o644, 0o7777, 0))
                tar.addfile(entry)
        packed = gzip.compress(stream.getvalue()) if choose.random() < 0.5 else stream.getvalue()
    file.write_bytes(packed)
    return f"tar with {names}"


# -- judging


def _documents(text: str) -> list[dict[str, Any]]:
    """Return the JSON objects that follow each other in a text."""
    found, decoder, at = [], json.JSONDecoder(), 0
    while (at := text.find("{", at)) >= 0:
        try:
            value, at = decoder.raw_decode(text, at)
        except ValueError:
            at += 1
            continue
        found.append(value)
    return found


def _totals(facts: dict[str, Any]) -> tuple[int, int]:
    rows = facts["splits"].values()
    return sum(r["images"] for r in rows), sum(r["objects"] + r["ignore_regions"] for r in rows)


def _same_labels(lab: Path, outcome: Outcome, before: dict[str, str]) -> str:
    """Return a message if a conversion that succeeded has fewer pictures or labels than its source."""
    found = _documents(outcome.results)
    if len(found) != 4 or "error" in str(sorted(found[1])) or "splits" not in found[1] or "splits" not in found[3]:
        return ""
    (images, objects), (images_now, objects_now) = _totals(found[1]), _totals(found[3])
    if any(p["severity"] == "error" for p in found[2].get("problems", ())):
        return ""
    lost = sum(found[2].get("losses", {}).values()) + sum(found[2].get("counts", {}).get("labels_dropped", {}).values())
    if images_now < images or objects_now + lost < objects:
        return f"{images} pictures with {objects} labels became {images_now} with {objects_now}; {lost} reported"
    return ""


def _same_output(lab: Path, outcome: Outcome, before: dict[str, str]) -> str:
    """Return a message if a command that succeeded left other files than an undisturbed one."""
    if outcome.code:
        return ""
    now = contents(output(lab), _NOT_COMPARED)
    if "an edited card" in outcome.output:  # which is kept, with a warning
        now["README.md"] = before["README.md"]
    return differences(now, before) if any(now.get(k) != v for k, v in before.items()) else ""


def _same_output_beside_mine(lab: Path, outcome: Outcome, before: dict[str, str]) -> str:
    """Return a message as `_same_output` does, or if a file of the user was removed."""
    places = output(lab), partial_of(output(lab))  # a resume that failed leaves the run under its partial name
    if not any((place / "mine" / "mine.txt").is_file() for place in places):
        return "a file of the user was removed"
    return _same_output(lab, outcome, before)


_NOT_COMPARED = ("workers.log", "mine/", "convert.json", "run.json", "run.sqlite", "preview.png", "report.html")
"""Files that list warnings and times, and what is not of the command."""


# -- the inputs


def _sample(name: str) -> Input:
    form = name.partition(":")[0]
    return Input(
        f"dataset {name}",
        lambda lab: SAMPLES[name](lab / "in" / "data"),
        _break_files("in/data"),
        lambda lab: [
            ["-q", "check", lab / "in" / "data", "--json"],
            ["-q", "inspect", lab / "in" / "data", "--format", form, "--json"],
            ["-q", "convert", lab / "in" / "data", output(lab), "--format", form, "--to", "coco", "--json"],
            ["-q", "inspect", output(lab), "--json"],
        ],
        0.5 / len(SAMPLES),
        _same_labels,
    )


def _recipe(lab: Path) -> None:
    SAMPLES["coco"](lab / "in" / "data")
    folder = Path(__file__).resolve().parents[2] / "src" / "infrablend" / "config" / "recipes"
    for k, path in enumerate(sorted(folder.glob("*.yaml"))):
        top = yaml.safe_load(path.read_text())
        top.setdefault("camera", {})
        top["camera"] |= {"pitch": {"fixed_deg": 60}, "size_px": [64, 48]}
        (lab / "in" / "recipes" / f"{k}").mkdir(parents=True)
        (lab / "in" / "recipes" / f"{k}" / "recipe.yaml").write_text(yaml.safe_dump(top))


def _break_recipe(lab: Path, choose: Choice) -> str:
    number = choose.choice(sorted(p.name for p in (lab / "in" / "recipes").iterdir()))
    said = _break_yaml(f"in/recipes/{number}/recipe.yaml")(lab, choose)
    shutil.move(lab / "in" / "recipes" / number, lab / "in" / "chosen")
    return f"recipe {number}: {said}"


def _profile(lab: Path) -> None:
    _recipe(lab)
    (lab / "in" / "profile.json").write_text(PROFILES["hit-uav"].model_dump_json())


def _break_profile(lab: Path, choose: Choice) -> str:
    top = json.loads((lab / "in" / "profile.json").read_text())
    said = [break_value(top, choose) for _ in range(choose.randint(1, 3))]
    text = json.dumps(top)
    (lab / "in" / "profile.json").write_text(text[: choose.choice((len(text), len(text), choose.randrange(len(text))))])
    return "; ".join(said)


def _table(lab: Path) -> None:
    SAMPLES["yolo:detect"](lab / "in" / "data")
    rows = [p.name for p in sorted((lab / "in" / "data").rglob("*.jpg"))]
    (lab / "in" / "tables").mkdir()
    text = "file,pitch_deg,altitude_m,time_of_day\n" + "".join(f"{n},30,50.5,day\n" for n in rows)
    (lab / "in" / "tables" / "table.csv").write_text(text)
    table = [{"file": n, "pitch_deg": 45, "altitude_m": 60.5, "time_of_day": "night"} for n in rows]
    (lab / "in" / "tables" / "table.json").write_text(json.dumps(table))


def _finished_run(lab: Path) -> None:
    SAMPLES["coco"](lab / "in" / "data")
    done(lab, *generate_words(lab, output(lab)))
    (output(lab) / "mine").mkdir()
    (output(lab) / "mine" / "mine.txt").write_text("mine")


def _finished_merge(lab: Path) -> None:
    write_shards(lab)
    done(lab, "-q", "merge", lab / "in" / "shards", output(lab))


def _finished_packed_merge(lab: Path) -> None:
    write_shards(lab, *PACKED)
    done(lab, "-q", "merge", lab / "in" / "shards", output(lab))


def _reviewed_run(lab: Path) -> None:
    """Write a run, and a review of its frames beside it."""
    _finished_run(lab)
    shutil.rmtree(output(lab) / "mine")
    frames = {"train/0_60_30_0_00001_c0": {"verdict": "reject", "reason": "too bright"}}
    frames |= {"val/1_90_60_0_00023_c0": {"verdict": "accept"}}
    (lab / "in" / "review").mkdir()
    (lab / "in" / "review" / REVIEW_FILE).write_text(json.dumps({"frames": frames}))


def _break_review(lab: Path, choose: Choice) -> str:
    """Break a review, and put it in the run."""
    file = lab / "in" / "review" / REVIEW_FILE
    if choose.random() < 0.3:
        said = mutate(file.parent, lab / "canary", choose)
    else:
        top = json.loads(file.read_text())
        said = "; ".join(break_value(top, choose) for _ in range(choose.randint(1, 3)))
        file.write_text(json.dumps(top))
    for path in file.parent.iterdir():
        shutil.move(path, output(lab) / path.name)
    return said


def _finished_conversion(lab: Path) -> None:
    SAMPLES["coco"](lab / "in" / "data")
    done(lab, "-q", "convert", lab / "in" / "data", output(lab), "--to", "voc")


def _break_records(lab: Path, choose: Choice) -> str:
    """Break the ledger of a run, or anything else in it but the user's file."""
    out, aside = output(lab), lab / "aside"
    part = choose.choice(("run.sqlite", "run.sqlite", "images", "", "yolo", "coco"))
    if part == "run.sqlite":
        data = bytearray((out / part).read_bytes())
        at = choose.randrange(len(data))
        for n in range(at, min(at + choose.choice((1, 1, 100, 5000)), len(data))):
            data[n] ^= 1 << choose.randrange(8)
        (out / part).write_bytes(data[: choose.choice((len(data), len(data), at))])
        return f"{part} at {at}"
    shutil.move(out / "mine", aside)
    said = mutate(out / part, lab / "canary", choose)
    out.mkdir(exist_ok=True)
    shutil.move(aside, out / "mine")
    return f"{part}: {said}"


def _break_conversion(lab: Path, choose: Choice) -> str:
    """Break a finished conversion."""
    said = mutate(output(lab), lab / "canary", choose)
    output(lab).mkdir(exist_ok=True)
    return said


def _archive(lab: Path) -> None:
    SAMPLES["hit-uav:json"](lab / "in" / "made")
    with zipfile.ZipFile(lab / "in" / "data.zip", "w") as archive:
        for path in sorted((lab / "in" / "made").rglob("*")):
            archive.write(path, path.relative_to(lab / "in" / "made"))


def _predictions(lab: Path) -> None:
    write_detections(lab)
    (lab / "in" / "saved").mkdir()
    shutil.move(lab / "in" / "predictions.json", lab / "in" / "saved" / "predictions.json")


def _experiment(lab: Path) -> None:
    write_clips(lab)
    (lab / "in" / "experiment").mkdir()
    (lab / "in" / "experiment" / "small.yaml").write_text(EXPERIMENT)
    folder = Path(__file__).resolve().parents[2] / "src" / "infrablend" / "config" / "experiments"
    for path in sorted(folder.glob("*.yaml")):
        shutil.copy(path, lab / "in" / "experiment" / path.name)


def _break_experiment(lab: Path, choose: Choice) -> str:
    name = choose.choice(sorted(p.name for p in (lab / "in" / "experiment").iterdir()))
    (lab / "in" / "chosen").mkdir()
    shutil.move(lab / "in" / "experiment" / name, lab / "in" / "chosen" / "small.yaml")
    return f"{name}: {_break_yaml('in/chosen/small.yaml')(lab, choose)}"


def _break_model(lab: Path, choose: Choice) -> str:
    folder = choose_model(lab, choose)
    return "; ".join([folder.name, *(mutate(folder, lab / "canary", choose) for _ in range(choose.randint(0, 2)))])


def _recipe_words(lab: Path) -> list[Words]:
    found = sorted((lab / "in" / "chosen").rglob("*"))
    file = found[0] if found else lab / "in" / "chosen"
    words: Words = ["-q", "generate", file, "--data", lab / "in" / "data", "--out", output(lab), "--to", "coco"]
    return [[*words, "--plan"], [*words, "--limit", "1", "--workers", "1"]]


INPUTS: tuple[Input, ...] = (
    *(_sample(name) for name in sorted(SAMPLES)),
    Input("recipe", _recipe, _break_recipe, _recipe_words, 0.12),
    Input(
        "sensor profile",
        _profile,
        _break_profile,
        lambda lab: [
            generate_words(lab, output(lab), "--limit", "1", "--set", f"sensor.profile={lab}/in/profile.json"),
        ],
        0.02,
    ),
    Input(
        "experiment file",
        _experiment,
        _break_experiment,
        lambda lab: [
            ["-q", "experiment", lab / "in" / "chosen" / "small.yaml", "--data", lab / "in" / "data", "--plan"],
        ],
        0.06,
    ),
    Input(
        "model",
        write_models,
        _break_model,
        lambda lab: [["-q", "models", "describe", lab / "in" / "chosen" / "thing.yaml"]],
        0.05,
    ),
    Input(
        "metadata table",
        _table,
        _break_files("in/tables"),
        lambda lab: [
            ["-q", "inspect", lab / "in" / "data", "--metadata", lab / "in" / "tables" / "table.csv", "--json"],
            ["-q", "inspect", lab / "in" / "data", "--metadata", lab / "in" / "tables" / "table.json", "--json"],
        ],
        0.06,
    ),
    Input(
        "records of a run",
        _finished_run,
        _break_records,
        lambda lab: [
            ["-q", "check", output(lab) / "coco"],
            ["-q", "check", output(lab)],  # names edits that keep the size, which --resume does not look for
            ["-q", "preview", output(lab), "--out", lab / "own" / "sheet.png"],
            ["-q", "report", output(lab)],
            generate_words(lab, output(lab), "--resume"),
        ],
        0.05,
        _same_output_beside_mine,
    ),
    Input(
        "shards of a run",
        _finished_merge,
        _break_files("in/shards"),
        lambda lab: [
            ["-q", "status", lab / "in" / "shards"],
            ["-q", "merge", lab / "in" / "shards", output(lab), "--overwrite"],
        ],
        0.02,
        _same_output,
    ),
    Input(
        "packed shards",
        _finished_packed_merge,
        _break_files("in/shards"),
        lambda lab: [
            ["-q", "status", lab / "in" / "shards"],
            ["-q", "check", lab / "in" / "shards"],
            ["-q", "merge", lab / "in" / "shards", output(lab), "--overwrite"],
            ["-q", "inspect", lab / "in" / "shards", "--json"],
        ],
        0.02,
        _same_output,
    ),
    Input(
        "review of a run",
        _reviewed_run,
        _break_review,
        lambda lab: [
            ["-q", "exclude", output(lab), "--review"],
            ["-q", "report", output(lab)],
            ["-q", "check", output(lab) / "coco"],
        ],
        0.03,
    ),
    Input(
        "records of a conversion",
        _finished_conversion,
        _break_conversion,
        lambda lab: [
            ["-q", "check", output(lab)],
            ["-q", "convert", lab / "in" / "data", output(lab), "--to", "voc", "--overwrite"],
        ],
        0.06,
        _same_output,
    ),
    Input(
        "archive",
        _archive,
        _break_archive,
        lambda lab: [["-q", "fetch", "hit-uav", output(lab), "--archive", lab / "in" / "data.zip"]],
        0.07,
    ),
    Input(
        "predictions",
        _predictions,
        _break_files("in/saved"),
        lambda lab: [
            ["-q", "evaluate", lab / "in" / "saved" / "predictions.json", lab / "in" / "data", "--out", output(lab),
             "--bootstrap", "2"],
        ],
        0.06,
    ),
)  # fmt: skip


def comparable(lab: Path) -> dict[str, str]:
    """Return the digests of the intact output in a lab, where the attack begins with one."""
    return contents(output(lab), _NOT_COMPARED) if (output(lab)).is_dir() else {}


def attack(kind: Input, intact: Path, lab: Path, before: dict[str, str], seed: str) -> list[Finding]:
    """Break a copy of intact inputs once, and judge the commands that read it."""
    shutil.rmtree(lab, ignore_errors=True)
    shutil.copytree(intact, lab, symlinks=True, copy_function=shutil.copy2)
    case = f"seed {seed}: "
    try:
        case += kind.breaks(lab, random.Random(seed))
    except (OSError, ValueError, IndexError, yaml.YAMLError, RecursionError) as error:
        case += f"broken no further ({error})"
    if not kind.name.startswith(("dataset", "model")):
        for path in sorted((lab / "in").rglob("*")):
            # A user who names a pipe waits for it, and one who names a link wants its target.
            if path.is_fifo() or (path.is_symlink() and not is_inside(path, lab / "in")):
                path.unlink()
    around = snapshot(lab, "in", PLACE, "own")
    outcome = fork_command(kind.words(lab), lab, lab / PLACE)
    findings: list[Finding] = []
    name = f"broken {kind.name.partition(':')[0]}"
    if outcome.code == TIMED_OUT:
        findings.append(Finding(name, case, "hang", outcome.output[-500:]))
    elif not outcome.named:
        said = f"exit {outcome.code}: {outcome.output[-700:]}\n{outcome.log[-2500:]}"
        findings.append(Finding(name, case, "unexpected error", said))
    elif lost := kind.judge(lab, outcome, before):
        findings.append(Finding(name, case, "silent loss", lost))
    changed = differences(snapshot(lab, "in", PLACE, "own"), around)
    if outcome.outside or changed:
        findings.append(Finding(name, case, "file outside", f"{'; '.join(outcome.outside[:4])} {changed}"))
    return findings


def run(root: Path, number: int, seed: int, part: tuple[int, int]) -> Iterator[tuple[str, list[Finding]]]:
    """Yield the kind and the findings of each attack; the arguments are those of `kills.run`."""
    for kind in INPUTS:
        place = root / "".join(c if c.isalnum() else "-" for c in kind.name)
        intact, lab = place / "intact", place / "lab"
        # The inputs are made where they are attacked: records contain their paths.
        new_lab(lab, kind.make)
        before = comparable(lab)
        shutil.move(lab, intact)
        for k in range(max(1, round(number * kind.share))):
            if k % part[1] == part[0]:
                yield (
                    f"broken {kind.name.partition(':')[0]}",
                    attack(kind, intact, lab, before, f"{seed}-{kind.name}-{k}"),
                )
        shutil.rmtree(place, ignore_errors=True)
