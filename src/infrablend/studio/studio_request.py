"""What a studio opens, and where it serves its pages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from infrablend.errors import ArgumentError
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.pipeline.plans.run_request import ONE_WORKER, Execution
from infrablend.studio.guard import LOOPBACK, is_loopback


@dataclass(frozen=True)
class Address:
    """Where to serve.

    Attributes:
        host: Address to listen on; only this machine can connect by default.
        port: Port [default: any free one].
        expose: Let other machines connect through --host, unencrypted.
    """

    host: str = LOOPBACK[0]
    port: int = 0
    expose: bool = False

    def __post_init__(self) -> None:
        if not is_loopback(self.host) and not self.expose:
            raise ArgumentError(
                f"--host {self.host}: other machines could connect, and the connection is not encrypted; expected a "
                "loopback address such as 127.0.0.1. Give --yes-expose as well if that is what you want; an SSH tunnel "
                "is safer"
            )


@dataclass(frozen=True)
class StudioRequest:
    """What to open.

    Attributes:
        recipe: Recipe to tune: name of a shipped one, or a YAML file.
        data: Folder of the background dataset to tune on.
        run: Run to review: folder that `generate` wrote.
        compare: Second run to compare with that of --run, or second recipe to compare with RECIPE on --data.
        detections: Detections to review: folder that `detect` wrote.
        results: Folder of a further report on the run, such as an evaluation; repeatable.
        seed: The same seed gives the same bytes.
        reading: How to read `data`.
        execution: Device and renderer.
    """

    recipe: str | None = None
    data: Path | None = None
    run: Path | None = None
    compare: str | None = None
    detections: Path | None = None
    results: tuple[Path, ...] = ()
    seed: int = 0
    reading: Reading = READ_ALL
    execution: Execution = ONE_WORKER
