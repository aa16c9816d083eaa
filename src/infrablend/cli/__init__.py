"""The command line: it only parses, calls `infrablend.api`, and shows what comes back.

stdout is for results, stderr for progress, warnings and errors.
"""

from __future__ import annotations

from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and give the exit code (see `infrablend.cli.exits`).

    Args:
        argv: Arguments without the program's name; those of this process by default.
    """
    import sys

    from infrablend.cli.app import build_app
    from infrablend.cli.exits import stopped_by_signals

    try:
        with stopped_by_signals():
            build_app()(args=sys.argv[1:] if argv is None else list(argv), prog_name="infrablend")
    except SystemExit as e:
        return e.code if isinstance(e.code, int) else int(e.code is not None)
    except KeyboardInterrupt:  # before the command has begun
        sys.stderr.write("interrupted\n")
        return 130
    return 0
