"""`infrablend report`: the report of a run."""

from __future__ import annotations

from infrablend.cli.options import RunArgument


def report(run: RunArgument) -> None:
    """Write the report of a finished run again: RUN/report.html, one page that works offline.

    `generate`, `exclude` and `include` write it at their end.
    """
    from infrablend import api
    from infrablend.cli.results import print_result

    print_result(str(api.report(run)))
