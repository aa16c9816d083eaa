"""Files of runs, conversions, experiments and models are read in one place, which refuses links out of their folder."""

from __future__ import annotations

import ast
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "src" / "infrablend"
# Readers of datasets, in `formats`, have rules of their own;
# `blender` opens what users choose as they choose software.
LAYERS = ("core", "assets", "config", "sampling", "detection", "pipeline", "report", "studio", "lab")
READS = {"read_text", "read_bytes", "imread", "np.load", "torch.load", "json.load", "os.open", "open", "Image.open"}
ALLOWED = {
    "assets/user_model.py": "imported geometry in the user's cache",
    "lab/experiments/definition.py": "shipped files, and one that the user names",
    "config/loading.py": "shipped files, and one that the user names",
    "config/sensor_profile.py": "a file that the user names",
    "core/files.py": "the place that all others use",
    "core/lazy_names.py": "a file of the package",
    "core/ledger.py": "the ledger, by SQLite",
    "core/run_folder.py": "the ledger, by SQLite",
    "core/operating_system.py": "files of the kernel, and files to flush them",
    "lab/evaluation/evaluation_comparison.py": "an open file",
    "detection/detections.py": "a file that the user names",
    "pipeline/storage/archive.py": "downloads, which it checks itself",
    "pipeline/execution/worker.py": "nothing, in place of stdin",
    "lab/realism/measure_objects.py": "bytes in memory",
    "pipeline/compose/frame.py": "backgrounds, which may be links",
    "pipeline/runs/make_shards.py": "the ledger, by SQLite",
    "pipeline/studies/profile.py": "pictures of a dataset, checked by its reader",
    "pipeline/runs/rerender.py": "a file that the user names",
    "pipeline/runs/begun_run.py": "the ledger, by SQLite",
    "pipeline/runs/sharded.py": "the ledger, by SQLite",
    "pipeline/compose/trial.py": "a file that the user names",
    "report/card.py": "the licence beside a dataset",
    "report/checking.py": "pictures of a dataset, checked by its reader",
    "detection/predict.py": "pictures of a dataset, checked by its reader, and weights that the user names",
    "lab/training/trainer.py": "checkpoints, which Ultralytics opens as well",
    "lab/training/training_job.py": "checkpoints, which Ultralytics opens as well",
    "lab/training/yolox_trainer.py": "its own checkpoints",
    "lab/training/yolox_network.py": "weights that the user names",
    "lab/realism/nets.py": "weights that torch has downloaded",
    "lab/world/world_renderer.py": "no file: it opens a scene in Blender",
    "lab/world/frame_files.py": "bytes in memory",
}
"""Modules that open files without `core.files.open_regular`, with what they open."""


def opens(path: Path) -> bool:
    """Return whether a module opens files for reading by itself."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        mode = [a.value for a in (*node.args, *(k.value for k in node.keywords)) if isinstance(a, ast.Constant)]
        writes = any(isinstance(m, str) and m.strip("b") in ("w", "a", "x") for m in mode)
        if (called in READS or called.rpartition(".")[2] in READS) and not writes:
            return True
    return False


def test_only_known_modules_open_files_themselves() -> None:
    found = {
        path.relative_to(PACKAGE).as_posix()
        for layer in LAYERS
        for path in sorted((PACKAGE / layer).rglob("*.py"))
        if opens(path)
    }
    assert found - ALLOWED.keys() == set(), "use open_regular, read_regular, load_json or sha256_of of core.files"
    assert ALLOWED.keys() - found == set(), "no longer needed in ALLOWED"
