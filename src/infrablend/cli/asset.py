"""`infrablend asset`: write Blender assets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def infrared_effect(
    out: Annotated[Path, typer.Option(metavar="FILE.blend", help="File to write.")],
) -> None:
    """Write the InfraredEffect node group as a .blend asset, for the Shader Editor."""
    from infrablend import api
    from infrablend.cli.results import print_result

    if out.suffix.lower() != ".blend":
        raise typer.BadParameter(f"{out} must end in .blend", param_hint="--out")
    print_result(str(api.write_infrared_effect(out)))
