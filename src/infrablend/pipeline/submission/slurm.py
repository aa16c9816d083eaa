"""Job arrays of SLURM, whose tasks are the shards of a run."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable

from infrablend.pipeline.submission.request import MARGIN_S, MERGE_GIB, Submission

_MOST_RESTARTS = 100
"""How often a shard is continued after its time limit: one that never gets on would run for ever."""


def slurm_script(job: Submission) -> str:
    """Return a Bash script that submits itself as a job array and as a job that merges the shards afterwards.

    Task I renders shard I; task 0 merges. A task that gets SIGUSR1 shortly before its time limit stops cleanly and is
    queued again; `--requeue` does the same for tasks whose machine fails.
    """
    limit = f"%{job.parallel}" if job.parallel else ""
    options = [
        f"--job-name={job.name}",
        f"--array=1-{job.shards}{limit}",
        f"--cpus-per-task={job.cores}",
        f"--mem={job.memory_gib}G",
        f"--time={job.minutes}",
        "--requeue",
        f"--signal=B:USR1@{MARGIN_S}",
        "--open-mode=append",
        "--output=%x-%A_%a.log",
        *([f"--partition={job.partition}"] if job.partition else []),
        *([f"--account={job.account}"] if job.account else []),
    ]
    head = "".join(f"#SBATCH {option}\n" for option in options)
    return f"""\
#!/bin/bash
# Run in {job.shards} shards by InfraBlend. `bash FILE` submits the shards, and a job that merges them afterwards.
{head}set -u

case "${{SLURM_ARRAY_TASK_ID:-submit}}" in
submit)
  shards=$(sbatch --parsable "$0") || exit
  shards=${{shards%%;*}}
  merge=$(sbatch --parsable --array=0 --job-name={job.name}-merge --cpus-per-task=1 \\
    --mem={MERGE_GIB}G --dependency="afterany:$shards" "$0") || exit
  echo "shards: job $shards, merge: job ${{merge%%;*}}"
  exit
  ;;
0)
  exec {quoted(job.merge)}
  ;;
esac

worker=
stopped=
time_is_over=
stop() {{
  stopped=yes
  if [ "$worker" ]; then kill -TERM "$worker"; fi
}}
trap stop TERM
trap 'time_is_over=yes; stop' USR1
{quoted(job.generate)} \\
  --shard "$SLURM_ARRAY_TASK_ID/{job.shards}" &
worker=$!
if [ "$stopped" ]; then stop; fi
# A signal ends `wait`, not the worker.
while
  code=0
  wait "$worker" || code=$?
  kill -0 "$worker" 2> /dev/null
do :; done
if [ "$time_is_over" ] && [ "$code" -gt 128 ] && [ "${{SLURM_RESTART_COUNT:-0}}" -lt {_MOST_RESTARTS} ]; then
  scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID"
fi
exit "$code"
"""


def quoted(words: Iterable[str]) -> str:
    """Return words as Bash reads them, in one line and in printable characters."""
    return " ".join(map(_quoted, words))


def _quoted(word: str) -> str:
    if word.isprintable():
        return shlex.quote(word)
    known = {"\n": "\\n", "\t": "\\t", "\\": "\\\\", "'": "\\'"}
    return "$'" + "".join(known.get(c) or (c if c.isprintable() else _escaped(c)) for c in word) + "'"


def _escaped(character: str) -> str:
    return "".join(f"\\x{byte:02x}" for byte in os.fsencode(character))
