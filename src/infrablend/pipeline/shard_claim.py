"""Claims in object storage, which has no locks: a small file that a job renews while it makes a shard."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import secrets
import socket
import time
from collections.abc import Iterator, Mapping
from typing import Any

from infrablend.errors import OutputError
from infrablend.pipeline.shard import Shard
from infrablend.storage.store import Store

log = logging.getLogger(__name__)

CLAIM_S = 900.0
"""Seconds after which a claim that was not renewed belongs to a job that died."""
_RENEW_S = 120.0
_LOOK_S = 10.0


class ShardClaim:
    """Notice in storage that a job makes a shard."""

    def __init__(self, store: Store, shard: Shard) -> None:
        """Name the shard; nothing is written."""
        self._store, self._shard = store, shard
        self._name = f"{shard.folder_name}.claim"
        self._token = secrets.token_hex(8)
        self._renewed = 0.0

    def is_fresh(self) -> bool:
        """Return whether a job has renewed the claim lately."""
        return self._age_s(self._read()) < CLAIM_S

    @contextlib.contextmanager
    def held(self, *, wait: bool = False) -> Iterator[None]:
        """Claim the shard during the block.

        Args:
            wait: Whether to wait until the claim of a job that may have died is void, instead of refusing at once. A
                scheduler starts a job again as soon as its machine is lost.

        Raises:
            OutputError: Another job makes it.
        """
        if not self._store.write(self._name, self._text(), new=True):
            other = self._read()
            if not self._is_void(other):
                if not wait:
                    raise self._refused(other)
                self._wait(other)
            log.info("%s: claim of a job that is gone; taken over", self._store.place(self._name))
            self._store.write(self._name, self._text())
        self._renewed = time.monotonic()
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # a claim that stays goes stale
                if self._read().get("token") == self._token:
                    self._store.remove(self._name)

    def _is_void(self, other: Mapping[str, Any]) -> bool:
        """Return whether the job of another claim is gone: silent for long, or a process of this machine that ended."""
        if self._age_s(other) >= CLAIM_S:
            return True
        process = other.get("process")
        if other.get("host") != socket.gethostname() or type(process) is not int:
            return False
        # In a container that was started again, processes have the same numbers.
        return process == os.getpid() or not _is_alive(process)

    def _wait(self, other: Mapping[str, Any]) -> None:
        """Wait until a claim is gone or void.

        Raises:
            OutputError: It was renewed: its job is at work.
        """
        left_s = CLAIM_S - self._age_s(other)
        log.warning(
            "%s: shard %s was claimed by %s, which may have died; waiting for up to %.0f s. Remove %s if it did",
            self._store.address, self._shard, _named(other), left_s, self._store.place(self._name),
        )  # fmt: skip
        end = time.monotonic() + left_s
        while time.monotonic() < end:
            time.sleep(_LOOK_S)
            now = self._read()
            if not now:
                return
            if now != other:
                raise self._refused(now)

    def _refused(self, other: Mapping[str, Any]) -> OutputError:
        return OutputError(
            f"{self._store.address}: shard {self._shard} is being made by {_named(other)}, which reported "
            f"{self._age_s(other):.0f} s ago; expected nobody. Wait for it, or repeat the command {CLAIM_S:.0f} s "
            f"after it stopped, or remove {self._store.place(self._name)}"
        )

    def renew(self) -> None:
        """Write the claim again if the last time is a while ago; a job calls this while it works."""
        if time.monotonic() - self._renewed < _RENEW_S:
            return
        self._renewed = time.monotonic()
        try:
            self._store.write(self._name, self._text())
        except OSError as error:
            log.info("claim not renewed: %s", error)

    def _text(self) -> bytes:
        who = {"host": socket.gethostname(), "process": os.getpid(), "token": self._token, "time": time.time()}
        return json.dumps(who).encode()

    def _read(self) -> Mapping[str, Any]:
        try:
            found = json.loads(self._store.read(self._name) or b"{}")
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}

    def _age_s(self, claim: Mapping[str, Any]) -> float:
        """Return how long ago a claim was renewed, by the clock of this machine; endless for one that is damaged."""
        at = claim.get("time")
        return max(time.time() - at, 0.0) if isinstance(at, int | float) else float("inf")


def _named(claim: Mapping[str, Any]) -> str:
    return f"{claim.get('host', 'another machine')}, process {claim.get('process', 'unknown')}"


def _is_alive(process: int) -> bool:
    """Return whether a process of this machine exists."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
