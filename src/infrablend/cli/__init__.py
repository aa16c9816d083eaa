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
    import signal
    import sys
    import threading
    from types import FrameType

    from infrablend.cli.app import build_app

    def end_as_ctrl_c(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    in_main_thread = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, end_as_ctrl_c) if in_main_thread else None
    try:
        build_app()(args=sys.argv[1:] if argv is None else list(argv), prog_name="infrablend")
    except SystemExit as e:
        return e.code if isinstance(e.code, int) else int(e.code is not None)
    except KeyboardInterrupt:  # before the command has begun
        sys.stderr.write("interrupted\n")
        return 130
    finally:
        if in_main_thread:
            signal.signal(signal.SIGTERM, before or signal.SIG_DFL)
    return 0
