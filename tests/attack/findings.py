"""Count attempts and what went wrong in them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

Fault = Literal["silent loss", "unexpected error", "hang", "file outside"]
FAULTS: tuple[Fault, ...] = ("silent loss", "unexpected error", "hang", "file outside")


@dataclass(frozen=True)
class Finding:
    """One thing that went wrong.

    Attributes:
        kind: Kind of the attack.
        case: What was done, so that it can be repeated.
        fault: Column of the table.
        detail: What was seen.
    """

    kind: str
    case: str
    fault: Fault
    detail: str


@dataclass
class Tally:
    """Attempts and findings by kind of attack."""

    attempts: dict[str, int] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)

    def add(self, kind: str, found: Iterable[Finding]) -> None:
        """Count one attempt and what it found."""
        self.attempts[kind] = self.attempts.get(kind, 0) + 1
        self.findings += found

    def merge(self, other: Tally) -> None:
        """Add the figures of another process."""
        for kind, number in other.attempts.items():
            self.attempts[kind] = self.attempts.get(kind, 0) + number
        self.findings += other.findings

    def rows(self) -> list[tuple[str, int, *tuple[int, ...]]]:
        """Return kind, attempts and one number per fault: one row per kind, and the sum."""

        def row(name: str, kinds: Iterable[str]) -> tuple[str, int, *tuple[int, ...]]:
            wanted = set(kinds)
            mine = [f.fault for f in self.findings if f.kind in wanted]
            return (name, sum(self.attempts.get(k, 0) for k in wanted), *(mine.count(f) for f in FAULTS))

        return [*(row(k, [k]) for k in self.attempts), row("all", self.attempts)]

    def table(self) -> str:
        """Return the rows as a Markdown table."""
        head = ("attack", "attempts", "silent losses", "unexpected errors", "hangs", "files outside")
        lines = [head, ("---", *["---:"] * (len(head) - 1)), *self.rows()]
        return "\n".join("| " + " | ".join(str(c) for c in line) + " |" for line in lines)
