"""The page of an experiment: tables with the paper's figures beside ours, conclusions, what differs, plots, times.

Everything comes from the results' JSON, nothing from the clock or the disk: the same JSON gives the same bytes. Charts
only, no pictures of data.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from infrablend.core.dataset import SPLITS
from infrablend.core.files import write_bytes, write_json, write_text

# Apart from each other also for colour-blind readers.
OURS, PAPER, FAINT = "#0072b2", "#d55e00", "#9a9a9a"
CURVES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#1b1b1b", "#9a9a9a")
METRICS = {"p": "P", "r": "R", "map50": "mAP50", "map50_95": "mAP50-95"}
_EXPECT = {
    "below": "whole interval below 0",
    "above": "whole interval above 0",
    "within": "0 within the interval",
    "not_below": "interval not wholly below 0",
    "at_least": "ratio of at least {least:g}",
    "report": "reported, no verdict",
}
INDEX_FILE = "index.md"


def page_name(experiment: str, scale: str) -> str:
    """Stem of an experiment's files: its name; scales other than `small` are named behind it."""
    return experiment if scale == "small" else f"{experiment}-{scale}"


def write_page(facts: Mapping[str, Any], out: Path) -> Path:
    """Write `<name>.json`, `<name>.md`, plots `<name>_*.svg` and the index of all pages in `out`; returns the page.

    Raises:
        OutputError: The folder cannot be written.
    """
    # In the order in which the JSON has it: the page follows from that alone.
    facts = json.loads(json.dumps(facts, sort_keys=True))
    stem = page_name(facts["experiment"], facts["scale"])
    if facts["status"] != "complete" and _is_complete(out / f"{stem}.json"):
        stem += "-unfinished"  # what is complete stays
    kept = {k: v for k, v in facts.items() if k != "evaluations"}
    kept["evaluations"] = {n: _without_curves(e) for n, e in facts["evaluations"].items()}
    plots = [(f"{stem}_{name}.svg", title, svg) for name, title, svg in draw_plots(facts)]
    for name, _, svg in plots:
        write_bytes(out / name, svg)
    for old in sorted(out.glob(f"{stem}_*.svg")):
        if old.name not in {name for name, _, _ in plots}:
            old.unlink()  # of an earlier, fuller or other run
    write_json(out / f"{stem}.json", kept)
    page = write_text(out / f"{stem}.md", page_text(facts, [(name, title) for name, title, _ in plots], stem))
    write_text(out / INDEX_FILE, index_text(out))
    return page


def _is_complete(path: Path) -> bool:
    try:
        facts = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(facts, dict) and facts.get("status") == "complete"


def _without_curves(evaluation: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in evaluation.items() if k not in ("curves", "confusion")}


# The page.


def page_text(facts: Mapping[str, Any], plots: Sequence[tuple[str, str]] = (), stem: str | None = None) -> str:
    """The page, Markdown; `stem` is the name of its files."""
    stem = stem or page_name(facts["experiment"], facts["scale"])
    blocks = [f"# {facts['title']}", facts["description"]]
    blocks += [facts["about"]] if facts["about"] else []
    blocks.append(_head(facts))
    if facts["status"] != "complete":
        blocks.append(_unfinished(facts))
    if facts["left_out"]:
        lines = [f"* `{name}`: {why}." for name, why in facts["left_out"].items()]
        blocks.append("Left out:\n\n" + "\n".join(lines))
    if facts["at_other_scales"]:
        blocks.append(f"At other scales only: {', '.join(f'`{n}`' for n in facts['at_other_scales'])}.")
    for table in facts["tables"]:
        blocks += [f"## {table['title']}", _table(table["rows"])]
        blocks += [table["note"]] if table["note"] else []
    if facts["tables"]:
        blocks.append(
            "Each cell: paper → ours (difference). In brackets the 95 % interval of ours, from a bootstrap over the "
            "test images. P and R are those at the confidence of best mean F1; AP by pycocotools, at most 300 findings "
            "an image."
        )
    if facts["datasets"]:
        blocks += ["## Datasets", _datasets(facts["datasets"])]
    if facts["checks"]:
        blocks += ["## Conclusions", _checks(facts["checks"])]
        if facts["scale"] == "smoke":
            blocks.append("A smoke run trains a few steps, to see that everything runs: it gives no verdicts.")
    if facts["comparisons"]:
        blocks += ["## Paired differences", _comparisons(facts["comparisons"])]
    blocks += ["## What differs from the paper", "\n".join(f"* {line}" for line in differences(facts))]
    if plots:
        blocks += ["## Plots", *(f"![{title}]({name})" for name, title in plots)]
    if any(e.get("ultralytics") for e in facts["evaluations"].values()):
        blocks += ["## The same by Ultralytics' own code", _ultralytics(facts["evaluations"])]
    blocks += _strata(facts["evaluations"], facts["strata_class"])
    blocks += ["## Stages", _stages(facts["stages"]), "## Where it ran", _where(facts)]
    blocks.append(f"All figures: [{stem}.json]({stem}.json). All experiments: [index]({INDEX_FILE}).")
    return "\n\n".join(blocks) + "\n"


def _head(facts: Mapping[str, Any]) -> str:
    """Scale, status, command."""
    said = f"**Scale: {facts['scale']}. {_standing(facts).capitalize()}.** Written by the command, not by hand:"
    return f"{said}\n\n```text\n{facts['command']}\n```"


def _standing(facts: Mapping[str, Any]) -> str:
    """How far it got; a run without the user's other datasets is not simply complete."""
    some_left_out = facts["status"] == "complete" and facts["left_out"]
    return "complete for the data at hand" if some_left_out else str(facts["status"])


def _unfinished(facts: Mapping[str, Any]) -> str:
    reason = f" It stopped: {facts['stopped']}." if facts["stopped"] else ""
    return (
        f"**This run is not finished.**{reason} Missing: {', '.join(f'`{m}`' for m in facts['missing'])}. "
        "The same command goes on."
    )


def _grid(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [list(header), ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(c.replace("|", "\\|") for c in line) + " |" for line in lines)


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows with paper, ours and difference in each cell; columns that nobody has figures for are left out."""
    counts = [
        k
        for k in ("images", "instances")
        if any(r["paper"][k] is not None or (r["ours"] or {}).get(k) is not None for r in rows)
    ]
    lines = []
    for r in rows:
        ours = r["ours"]
        cells = [r["title"]]
        cells += [_pair(_count(r["paper"][k]), _count(ours[k]) if ours else None) for k in counts]
        if ours is None:
            lines.append([*cells, *(_pair(_figure(r["paper"][k]), None) for k in METRICS)])
            continue
        for k in METRICS:
            cell = _pair(_figure(r["paper"][k]), _figure(ours[k]))
            if k in r["difference"]:
                cell += f" ({r['difference'][k]:+.3f})"
            if interval := (ours.get("ci") or {}).get(k):
                cell += f" [{interval[0]:.3f}, {interval[1]:.3f}]"
            cells.append(cell)
        lines.append(cells)
    text = _grid(["", *(k.capitalize() for k in counts), *METRICS.values()], lines)
    why = sorted({f"{r['title']}: {r['missing']}" for r in rows if r["missing"]})
    return text + ("\n\nWithout our figures: " + "; ".join(why) + "." if why else "")


def _pair(paper: str | None, ours: str | None) -> str:
    return f"{paper or '-'} → {ours or '-'}" if paper else ours or "-"


def _count(n: Any) -> str | None:
    return None if n is None else f"{n:,}"


def _figure(x: Any) -> str | None:
    return None if x is None else f"{x:.3f}"


def _datasets(rows: Sequence[Mapping[str, Any]]) -> str:
    lines = []
    for r in rows:
        paper, ours = r["paper"], r["ours"]
        if ours is None:
            cells = [_pair(_count(paper["images"]), None), _pair(_count(paper["classes"]), None)]
            lines.append([r["title"], *cells, _pair(", ".join(paper["labels"]), None), f"- ({r['missing']})"])
            continue
        lines.append(
            [
                r["title"],
                _pair(_count(paper["images"]), _count(ours["images"])),
                _pair(_count(paper["classes"]), _count(ours["classes"])),
                _pair(", ".join(paper["labels"]), ", ".join(ours["labels"])),
                f"{ours['instances']:,} of {', '.join(ours['names'])}",
            ]
        )
    return _grid(["Dataset", "Images", "Classes", "Labels", "Objects (ours)"], lines)


def _checks(checks: Sequence[Mapping[str, Any]]) -> str:
    lines = []
    for c in checks:
        verdict = {True: "**yes**", False: "**no**", None: "-"}[c["holds"]]
        if "missing" in c:
            found = c["missing"]
        elif "ratio" in c:
            found = f"{c['ratio']:.3f} = {c['values'][0]:.3f} / {c['values'][1]:.3f}"
        else:
            found = f"{c['difference']:+.3f} [{c['ci'][0]:+.3f}, {c['ci'][1]:+.3f}]"
            if c.get("same_sign") is not None:
                found += f", sign kept in {100 * c['same_sign']:.0f} % of draws"
        expected = _EXPECT[c["expect"]].format(least=c.get("least") or 0)
        lines.append([c["text"], f"{c['class']}, {METRICS[c['metric']]}", expected, found, verdict])
    return _grid(["Claim", "On", "Asked", "Found", "Holds"], lines)


def _comparisons(comparisons: Mapping[str, Mapping[str, Any]]) -> str:
    lines = []
    for c in comparisons.values():
        for name in sorted(c["classes"], key=_all_first):
            of_class = c["classes"][name]
            cells = []
            for k in ("map50", "map50_95"):
                d = of_class.get(k)
                cells.append("-" if d is None else f"{d['difference']:+.3f}{_interval(d.get('ci'))}")
            lines.append([c["title"], name, *cells])
    note = "On the same images, drawn together; in brackets the 95 % interval."
    if any(len(c["a"]) > 1 or len(c["b"]) > 1 for c in comparisons.values()):
        note += (
            " It holds what another seed of the training would change only where means of several are compared; "
            "then the detectors are drawn, too."
        )
    else:
        note += " What another seed of the training would change is not in it."
    return _grid(["Difference", "Class", "mAP50", "mAP50-95"], lines) + "\n\n" + note


def _interval(ci: Any) -> str:
    return "" if not ci else f" [{ci[0]:+.3f}, {ci[1]:+.3f}]"


def _ultralytics(evaluations: Mapping[str, Mapping[str, Any]]) -> str:
    tables = {n: e["ultralytics"] for n, e in evaluations.items() if e.get("ultralytics")}
    classes = sorted({c for t in tables.values() for c in t if isinstance(t[c], Mapping)}, key=_all_first)
    lines = [[c, *(_both(t.get(c)) for t in tables.values())] for c in classes]
    return _grid(["mAP50 / mAP50-95", *tables], lines)


def _both(figures: Mapping[str, Any] | None) -> str:
    """mAP50 / mAP50-95."""
    if figures is None or figures["map50"] is None:
        return "-"
    return f"{figures['map50']:.3f} / {figures['map50_95']:.3f}"


_STRATA = {"size": "longer side, px", "pitch": "camera pitch, °", "altitude": "altitude, m", "time": "time of day"}


def _strata(evaluations: Mapping[str, Mapping[str, Any]], category: str) -> Iterator[str]:
    """Sections of AP by size, pitch, altitude and time, of one class or all."""
    tables = []
    for kind, words in _STRATA.items():
        found = {n: of for n, e in evaluations.items() if (of := (e.get("strata") or {}).get(kind))}
        lines = []
        for stratum in sorted({s for of in found.values() for s in of}, key=_by_number):
            rows = [_of_class(of.get(stratum, {}).get("classes", {}), category) for of in found.values()]
            if any(r and r["instances"] for r in rows):
                lines.append([stratum, *(f"{_both(r)} of {r['instances']:,}" if r else "-" for r in rows)])
        if lines:
            tables.append(_grid([words, *found], lines))
    if tables:
        yield f"## By size, pitch, altitude and time: {'all classes' if category == 'all' else category}"
        yield "mAP50 / mAP50-95 of so many objects."
        yield from tables


def _all_first(name: str) -> tuple[bool, str]:
    return name != "all", name.casefold()


def _by_number(name: str) -> tuple[float, bool, str]:
    """`<8` before `8-16` before `16-32`; names without numbers last."""
    found = re.search(r"\d+(\.\d+)?", name)
    return float(found.group()) if found else float("inf"), not name.startswith("<"), name


def _of_class(figures: Mapping[str, Any], category: str) -> Mapping[str, Any] | None:
    return next((f for n, f in figures.items() if n.casefold() == category.casefold()), None)


def _stages(stages: Sequence[Mapping[str, Any]]) -> str:
    lines = [[f"`{s['stage']}`", f"`{s['key']}`", _count(s["images"]) or "-", _status(s)] for s in stages]
    total = sum(s["seconds"] or 0 for s in stages)
    return _grid(["Stage", "Key", "Images", "Time"], [*lines, ["all", "", "", _time(total)]])


def _status(stage: Mapping[str, Any]) -> str:
    """The time it took, or why there is none."""
    if stage["status"] != "complete":
        return "not done" if stage["status"] == "missing" else "not needed"
    if stage["adopted"] == "unchecked":
        return "taken over from elsewhere; how it was made was not checked"
    return "taken over from elsewhere, checked" if stage["adopted"] else _time(stage["seconds"])


def _time(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02} min"


def _where(facts: Mapping[str, Any]) -> str:
    lines = [f"* {k.replace('_', ' ')}: {', '.join(str(v) for v in values)}" for k, values in facts["hardware"].items()]
    versions = ", ".join(f"{k} {'/'.join(v)}" for k, v in facts["versions"].items())
    lines += [f"* versions: {versions}"] if versions else []
    lines += [f"* seed: {facts['seed']}", f"* commit: {', '.join(facts['commits']) or 'not a checkout'}"]
    return "\n".join(lines)


def differences(facts: Mapping[str, Any]) -> list[str]:
    """What differs in scale from the paper, a line each."""
    lines = []
    for s in facts["sources"].values():
        paper, ours, whole = s["paper_images"], s["images"], s["whole"]
        text = _plain(ours)
        if s["stand_in"]:
            lines.append(f"**{s['title']} is not here: a rendered virtual world stands in for it** ({text}).")
            continue
        line = f"{s['title']}: {text}"
        if ours != whole:
            line += f", a part of the {sum(whole.values()):,} that were given"
        if paper and paper != ours:
            line += f"; paper {_plain(paper)}"
        lines.append(line + ("." if not paper or paper != ours else ", as in the paper."))
    if facts["renderer"] != "blender":
        lines.append(f"Objects are drawn by the renderer `{facts['renderer']}`, flat shapes: this is a test run.")
    seen: dict[str, list[str]] = {}
    for name, t in facts["trainings"].items():
        seen.setdefault(_training(t), []).append(name)
    lines += [f"Detector {', '.join(names)}: {text}" for text, names in seen.items()]
    starts = {n: (t.get("start") or {}).get("kind") for n, t in facts["trainings"].items()}
    if len(set(starts.values())) > 1:
        which = ", ".join(f"{n} {kind}" for n, kind in sorted(starts.items()))
        lines.append(f"**The detectors did not start alike, so their differences say little**: {which}.")
    loose: dict[float, int] = {}
    for s in facts["stages"]:
        if s.get("boxes_loosened"):
            loose[s["loosened_by"]] = loose.get(s["loosened_by"], 0) + s["boxes_loosened"]
    lines += [
        f"Boxes of {n:,} inserted objects to train on are {by:g} times as wide and as high as the objects, as the "
        "source's annotators draw them; oriented boxes, masks and pictures are as they were."
        for by, n in sorted(loose.items())
    ]
    if facts["trainings"]:
        lines.append(
            "Paper: YOLOv8s, learning rate 0.002, batch 64, 640 px, at most 1000 epochs, patience 100; optimizer and "
            "start weights are not stated."
        )
    if facts["trainings"] and facts["scale"] == "smoke":
        lines.append("Scale `smoke`: a few steps, to see that everything runs; the detectors' figures mean nothing.")
    elif facts["trainings"] and facts["scale"] != "paper":
        lines.append(f"Scale `{facts['scale']}`: figures are to be compared with each other, not with the paper's.")
    return lines


def _training(record: Mapping[str, Any]) -> str:
    """What a training was, one line."""
    settings, prepared, start = record.get("settings") or {}, record.get("prepared") or {}, record["start"]
    parts = []
    if pictures := prepared.get("pictures"):
        of_paper = f" (paper {record['paper_images']:,} to train on)" if record.get("paper_images") else ""
        parts.append(f"pictures {_plain(pictures)}{of_paper}")
    if settings.get("model"):
        parts.append(settings["model"])
    if settings.get("tile"):
        count = (prepared.get("tiles") or {}).get("tiles")
        parts.append(f"{'' if count is None else f'{count:,} '}tiles of {settings['tile']} px at native resolution")
    if settings.get("image_size"):
        parts.append(f"{settings['image_size']} px")
    if record.get("batch"):
        parts.append(f"batch {record['batch']}")
    if record.get("passes"):
        parts.append(f"{record['passes']:,} images shown, epochs {record.get('epochs_done', '?')}")
    if record.get("seed"):
        parts.append(f"seed {record['seed']}")
    if start:
        parts.append("from scratch" if start.get("kind") == "scratch" else f"from {start.get('model')}")
        parts[-1] += f" ({start['why']})" if start.get("why") else ""
    parts += [str(record[k]) for k in ("precision", "note") if record.get(k)]
    if record.get("seconds"):
        parts.append(f"trained in {_time(record['seconds'])}")
    if record.get("adopted"):
        parts.append(
            "trained by a command of its own and taken over: settings, seed, numbers of images and labels agree"
        )
    return "; ".join(parts) + "."


def _plain(value: Mapping[str, int]) -> str:
    return ", ".join(f"{s} {value[s]:,}" for s in SPLITS if s in value)


# The index.


def index_text(out: Path) -> str:
    """The page that lists all results in a folder."""
    lines = []
    for path in sorted(out.glob("*.json")):
        try:
            facts = json.loads(path.read_text("utf-8"))
            checks = [c["holds"] for c in facts["checks"]]
            row = [
                f"[{facts['title']}]({path.stem}.md)",
                facts["scale"],
                _standing(facts),
                _headline(facts),
                f"{checks.count(True)} of {checks.count(True) + checks.count(False)}" if any_said(checks) else "-",
            ]
        except (OSError, ValueError, KeyError, TypeError):
            continue  # not one of ours
        lines.append(row)
    text = [
        "# Results",
        "Written by `infrablend experiment`, a page for each run, never by hand; negative and unfinished ones too. "
        "What they are and how to run them: [experiments](../how_to/experiments.md)."
        if out.name == "results" and out.parent.name == "docs"
        else "Written by `infrablend experiment`, a page for each run; never by hand.",
        _grid(["Experiment", "Scale", "Status", "First row, mAP50: paper → ours", "Conclusions that hold"], lines)
        if lines
        else "None yet.",
    ]
    return "\n\n".join(text) + "\n"


def any_said(verdicts: Sequence[bool | None]) -> bool:
    """Whether any check has a verdict."""
    return any(v is not None for v in verdicts)


def _headline(facts: Mapping[str, Any]) -> str:
    for table in facts["tables"]:
        for r in table["rows"]:
            return f"{r['title']}: {_pair(_figure(r['paper']['map50']), _figure((r['ours'] or {}).get('map50')))}"
    return "-"


# The plots.


def draw_plots(facts: Mapping[str, Any]) -> list[tuple[str, str, bytes]]:
    """(name, title, SVG) of every plot that there are figures for."""
    plots = []
    rows = [(t["title"], r) for t in facts["tables"] for r in t["rows"] if r["ours"] is not None]
    if rows:
        plots.append(("bars", "Ours with 95 % intervals, the paper's figures as crosses", _bars(rows)))
    if facts["comparisons"]:
        plots.append(("differences", "Paired differences with 95 % intervals", _forest(facts["comparisons"])))
    curves = {n: e["curves"] for n, e in facts["evaluations"].items() if e.get("curves")}
    if curves:
        plots.append(("pr", "Precision over recall at IoU 0.5", _curves(curves)))
    return plots


def _svg(figure: Figure) -> bytes:
    """The figure as SVG without dates and random ids."""
    out = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "infrablend", "svg.fonttype": "none", "path.simplify": True}):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()


def _bars(rows: Sequence[tuple[str, Mapping[str, Any]]]) -> bytes:
    figure = Figure(figsize=(9, 1.0 + 0.34 * len(rows)), layout="constrained")
    axes: Any = figure.subplots(1, 2, sharey=True)
    y = np.arange(len(rows))[::-1]
    for ax, metric in zip(axes, ("map50", "map50_95"), strict=True):
        for at, (_, r) in zip(y, rows, strict=True):
            value, ci = r["ours"][metric], (r["ours"].get("ci") or {}).get(metric)
            if value is not None:
                ax.barh(at, value, height=0.6, color=OURS, alpha=0.75)
            if ci:
                ax.plot(ci, [at, at], color="#1b1b1b", lw=1.4)
            if r["paper"][metric] is not None:
                ax.plot(r["paper"][metric], at, marker="x", color=PAPER, ms=7, mew=1.8, ls="")
        ax.set(xlim=(0, 1.02), xlabel=METRICS[metric])
        ax.spines[["top", "right"]].set_visible(False)
    several = len({t for t, _ in rows}) > 1
    names = [f"{r['evaluation']}: {r['title']}" if several else r["title"] for _, r in rows]
    axes[0].set_yticks(y, names, fontsize=8)
    axes[1].plot([], [], marker="x", color=PAPER, ls="", mew=1.8, label="paper")
    axes[1].barh([], [], color=OURS, alpha=0.75, label="ours")
    figure.legend(*axes[1].get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside upper right", ncols=2)
    return _svg(figure)


def _forest(comparisons: Mapping[str, Mapping[str, Any]]) -> bytes:
    rows = [
        (f"{c['title']}, {name}", c["classes"][name])
        for c in comparisons.values()
        for name in sorted(c["classes"], key=_all_first)
    ]
    figure = Figure(figsize=(9, 1.0 + 0.3 * len(rows)), layout="constrained")
    axes: Any = figure.subplots(1, 2, sharey=True)
    y = np.arange(len(rows))[::-1]
    for ax, metric in zip(axes, ("map50", "map50_95"), strict=True):
        ax.axvline(0, color=FAINT, lw=0.8)
        for at, (_, of) in zip(y, rows, strict=True):
            d = of.get(metric)
            if d is None:
                continue
            ax.plot(d["difference"], at, marker="o", color=OURS, ms=5, ls="")
            if d.get("ci"):
                ax.plot(d["ci"], [at, at], color=OURS, lw=1.6)
        ax.set(xlabel=f"difference of {METRICS[metric]}")
        ax.locator_params(axis="x", nbins=5)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_yticks(y, [name for name, _ in rows], fontsize=8)
    return _svg(figure)


def _curves(curves: Mapping[str, Mapping[str, Any]]) -> bytes:
    figure = Figure(figsize=(3.4 * len(curves), 3.2), layout="constrained")
    axes: Any = figure.subplots(1, len(curves), squeeze=False)
    for ax, (name, of) in zip(axes[0], curves.items(), strict=True):
        for k, (category, precision) in enumerate(sorted(of["precision"].items())):
            ax.plot(of["recall"], precision, color=CURVES[k % len(CURVES)], lw=1.4, label=category)
        ax.set(title=name, xlabel="recall", ylabel="precision", xlim=(0, 1), ylim=(0, 1.02))
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(frameon=False, fontsize=7, loc="lower left")
    return _svg(figure)
