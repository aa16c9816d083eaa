"""Writes the script of a run in shards, or hands it to the scheduler's own client."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from infrablend.core.arguments import require_choice
from infrablend.errors import MissingDependencyError, OutputError
from infrablend.pipeline.submission.kubernetes import kubernetes_manifest
from infrablend.pipeline.submission.request import SCHEDULERS, Scheduler, Submission
from infrablend.pipeline.submission.slurm import slurm_script

_CLIENTS = {"slurm": "sbatch", "kubernetes": "kubectl"}


def submission_text(job: Submission, to: Scheduler) -> str:
    """Return the Bash script or the YAML manifest of a run in shards.

    Raises:
        ArgumentError: The scheduler is unknown, or needs something that is missing.
    """
    require_choice("to", to, SCHEDULERS)
    return slurm_script(job) if to == "slurm" else kubernetes_manifest(job)


def submit(job: Submission, to: Scheduler) -> str:
    """Submit a run in shards from this machine; return what the scheduler's client says.

    Raises:
        ArgumentError: See `submission_text`.
        MissingDependencyError: The client, sbatch or kubectl, is not installed.
        OutputError: The client refuses the jobs.
    """
    text = submission_text(job, to)
    client = _CLIENTS[to]
    if shutil.which(client) is None:
        raise MissingDependencyError(
            f"{client} is not installed here: write the script with --print, and submit it where {client} is"
        )
    with tempfile.TemporaryDirectory(prefix="infrablend-") as folder:
        file = Path(folder) / "job"
        file.write_text(text, encoding="utf-8")
        words = ["bash", str(file)] if to == "slurm" else [client, "create", "-f", str(file)]
        ended = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
    if ended.returncode:
        raise OutputError(f"{client} refused the jobs: {(ended.stderr or ended.stdout).strip()[-2000:]}")
    return ended.stdout.strip()
