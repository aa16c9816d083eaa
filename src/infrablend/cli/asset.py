"""`infrablend asset`: Blender files made on request."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def infrared_effect(
    out: Annotated[Path, typer.Option(metavar="FILE.blend", help="Where to write it.")],
) -> None:
    """Write the InfraredEffect node group as a .blend asset, for use by hand in the Shader Editor."""
    from infrablend import api
    from infrablend.cli.results import print_result

    if out.suffix.lower() != ".blend":
        raise typer.BadParameter(f"{out} must end in .blend", param_hint="--out")
    print_result(str(api.write_infrared_effect(out)))
