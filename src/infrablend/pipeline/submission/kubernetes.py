"""Indexed Jobs of Kubernetes, whose pods are the shards of a run."""

from __future__ import annotations

from typing import Any

import yaml

from infrablend.core.addresses import address_of, shown
from infrablend.errors import ArgumentError
from infrablend.pipeline.submission.request import MARGIN_S, MERGE_GIB, Submission

_RETRIES = 6
_WAIT_S = 30 * 86_400


def kubernetes_manifest(job: Submission) -> str:
    """Return the YAML of an Indexed Job, one pod a shard, and of a Job that waits for the shards and merges them.

    Raises:
        ArgumentError: There is no image or volume, a path is on no volume, or a text is not UTF-8.
    """
    if job.image is None or not job.volumes:
        missing = "image" if job.image is None else "volume"
        raise ArgumentError(f"{missing}: Kubernetes needs a container image and a volume; found no {missing}")
    if len({v.path for v in job.volumes}) < len(job.volumes):
        raise ArgumentError("volume: found two on the same path, expected a path of its own for each")
    for path in dict.fromkeys((*job.paths, job.out, job.into)):
        if address_of(path) is None and not any(v.contains(path) for v in job.volumes):
            found = ", ".join(v.path for v in job.volumes)
            raise ArgumentError(f"{path}: is on none of the volumes ({found}); give a path as the pods see it")
    for word in (*job.generate, *job.merge):
        try:
            word.encode()
        except UnicodeEncodeError as error:
            raise ArgumentError(f"{word!r}: is not UTF-8, which a manifest has to be; rename it") from error
    documents = [_shards(job), _merge(job)]
    return yaml.safe_dump_all(documents, sort_keys=False, default_flow_style=False, width=10_000)


def _shards(job: Submission) -> dict[str, Any]:
    # `sh` adds the number, because indices of Kubernetes begin at 0; the words are not its to read.
    script = f'exec "$@" --shard "$((JOB_COMPLETION_INDEX + 1))/{job.shards}"'
    shard = _container(job, "shard", ["/bin/sh", "-c", script, "shard", *job.generate], job.cores, job.memory_gib)
    spec = {
        "completionMode": "Indexed",
        "completions": job.shards,
        "parallelism": job.at_once,
        "backoffLimitPerIndex": _RETRIES,
        "maxFailedIndexes": job.shards,
        "podFailurePolicy": {
            "rules": [
                {"action": "Ignore", "onPodConditions": [{"type": "DisruptionTarget"}]},
                # Failed frames, a wrong command and bugs do not go away by repeating.
                {"action": "FailIndex", "onExitCodes": {"operator": "In", "values": [1, 2, 70]}},
            ]
        },
        "template": _template(job, shard),
    }
    return _job(f"{job.name}-shards", spec)


def _merge(job: Submission) -> dict[str, Any]:
    wait = [*job.program, "--quiet", "status", "--wait", "--", shown(job.out)]
    # Shards with failed frames are merged, too, and `merge` refuses unfinished ones by itself.
    first = _container(job, "wait", ["/bin/sh", "-c", '"$@" || true', "wait", *wait], 1, 1)
    template = _template(job, _container(job, "merge", job.merge, 1, MERGE_GIB))
    template["spec"]["initContainers"] = [first]
    return _job(
        f"{job.name}-merge",
        {"backoffLimit": _RETRIES, "activeDeadlineSeconds": _WAIT_S, "template": template},
    )


def _job(name: str, spec: dict[str, Any]) -> dict[str, Any]:
    return {"apiVersion": "batch/v1", "kind": "Job", "metadata": {"name": name}, "spec": spec}


def _template(job: Submission, container: dict[str, Any]) -> dict[str, Any]:
    volumes: list[dict[str, Any]] = [
        {"name": f"volume-{n}", "persistentVolumeClaim": {"claimName": v.claim}} for n, v in enumerate(job.volumes)
    ]
    volumes.append({"name": "shared-memory", "emptyDir": {"medium": "Memory", "sizeLimit": "1Gi"}})
    return {
        "spec": {
            "restartPolicy": "Never",
            "terminationGracePeriodSeconds": MARGIN_S,
            "containers": [container],
            "volumes": volumes,
        }
    }


def _container(job: Submission, name: str, words: list[str], cores: int, memory_gib: int) -> dict[str, Any]:
    resources = {"cpu": str(cores), "memory": f"{memory_gib}Gi"}
    mounts = [{"name": f"volume-{n}", "mountPath": v.path} for n, v in enumerate(job.volumes)]
    return {
        "name": name,
        "image": job.image,
        # Kubernetes replaces $(NAME) in commands, and $$ by $.
        "command": [word.replace("$", "$$") for word in words],
        "resources": {"requests": resources, "limits": dict(resources)},
        "volumeMounts": [*mounts, {"name": "shared-memory", "mountPath": "/dev/shm"}],
    }
