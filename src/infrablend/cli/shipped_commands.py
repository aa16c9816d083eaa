"""What the package ships: `models`, `recipes` and `asset`; and `doctor`, which checks this machine."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend import api
from infrablend.cli.exits import ENVIRONMENT, printable
from infrablend.cli.options import Fields, JsonSession, complete_model, complete_shipped_recipe, yaml_values
from infrablend.cli.output import print_result, show_result, table

if TYPE_CHECKING:
    from infrablend.assets.model import ObjectModel

ModelArgument = Annotated[
    str,
    typer.Argument(metavar="NAME", help="Name of a model, or path of your own .yaml.", autocompletion=complete_model),
]


def list_models() -> None:
    """List the object models."""
    print_result(table(api.list_models()))


def describe_model(name: ModelArgument) -> None:
    """List the options, parts and temperatures of a model that a recipe can set."""
    print_result(_description(api.describe_model(name)))


def _description(model: ObjectModel) -> str:
    parts = {
        part: f"{role.delta_t_k[0]:+g} to {role.delta_t_k[1]:+g} K, {role.emissivity[0]:g} to {role.emissivity[1]:g}"
        + (f"  {role.what}" if role.what else "")
        for part, role in model.parts.items()
    }
    lines = [f"{model.name}: {model.description}\nCategory: {model.category}. Origin: {model.origin}."]
    if model.options:
        lines.append(f"\nOptions (objects.N.options)\n{table(model.options)}")
    lines.append(f"\nParts (objects.N.parts): surface minus air temperature, emissivity\n{table(parts)}")
    return "\n".join(lines)


def show_model(
    name: ModelArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="PNG", help="File to write [default: NAME.png in the current folder].")
    ] = None,
    options: Annotated[
        list[str] | None,
        typer.Option(
            "--option", metavar="KEY=VALUE", help="Option of the model, e.g. propellers=spinning; repeatable."
        ),
    ] = None,
) -> None:
    """Render a contact sheet of a model: from below, level and from above, and at 8 to 60 pixels.

    Its options, parts and temperatures are listed on stderr, so that stdout holds the path of the sheet alone.
    """
    settings = yaml_values(options, "--option")
    typer.echo(printable(_description(api.describe_model(name))), err=True)
    print_result(str(api.show_model(name, out or Path(f"{Path(name).stem}.png"), options=settings)))


def add_model(
    *,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="3D file: .glb, .gltf, .obj, .fbx, .usd* or .blend.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the description and the sheet [default: of FILE].")
    ] = None,
    answers: Annotated[
        api.ModelAnswers,
        Fields(
            category=typer.Option(metavar="NAME"),
            size_m=typer.Option(metavar="METRES"),
            parts=typer.Option("--part", metavar="NAME=ROLE"),
            up=typer.Option(metavar="AXIS", case_sensitive=False),
        ),
    ],
) -> None:
    """Describe a 3D file as a model: guess its parts from their names, ask for the rest, and render a sheet.

    On a terminal the command asks for what it cannot know; elsewhere it lists everything that is missing at once.
    """
    if sys.stdin.isatty() and sys.stderr.isatty():
        answers = _ask(file, answers)
    description = api.add_model(file, answers, out)
    print_result(str(description))
    print_result(str(api.show_model(str(description), description.with_suffix(".png"))))


def _ask(file: Path, answers: api.ModelAnswers) -> api.ModelAnswers:
    from infrablend.assets.part_roles import ROLES

    if not answers.category:
        answers = replace(answers, category=typer.prompt("Class of its labels (e.g. drone)", err=True))
    survey = api.survey_model(file, answers)
    if answers.size_m is None:
        size = " x ".join(f"{s:.3g}" for s in survey.file_size)
        question = f"Length of its longest side in metres (the file has {size} units)"
        answers = replace(answers, size_m=typer.prompt(question, type=float, err=True))
    for name in survey.unknown_parts:
        role = ""
        while role not in ROLES:
            role = typer.prompt(f"What is {name!r}? One of {', '.join(ROLES)}", err=True)
        answers = replace(answers, parts={**answers.parts, name: role})
    return answers


def list_recipes() -> None:
    """List the shipped recipes."""
    print_result(table(api.list_recipes()))


def show_recipe(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Name of a shipped recipe.", autocompletion=complete_shipped_recipe)
    ],
) -> None:
    """Print a recipe, to save and edit."""
    print_result(api.show_recipe(name).rstrip("\n"))


def infrared_effect(out: Annotated[Path, typer.Option(metavar="FILE.blend", help="File to write.")]) -> None:
    """Write the InfraredEffect node group as a .blend asset, for the Shader Editor."""
    if out.suffix.lower() != ".blend":
        raise typer.BadParameter(f"{out} must end in .blend", param_hint="--out")
    print_result(str(api.write_infrared_effect(out)))


def install_blender(
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to make [default: one in the cache folder].")
    ] = None,
    wheels: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of wheels to install from, without a network.")
    ] = None,
    python: Annotated[
        Path | None, typer.Option(metavar="PATH", help="Python 3.11 [default: this one, or one on the path].")
    ] = None,
) -> None:
    """Install Blender into an environment of its own (400 MB to download, 950 MB on disk)."""
    print_result(str(api.install_blender(out, wheels, python)))


def blender_requirements() -> None:
    """Print the path of the pinned requirements of Blender's environment, for `pip download`."""
    from infrablend.rendering.engine.install import REQUIREMENTS

    print_result(str(REQUIREMENTS))


def doctor(session: JsonSession) -> None:
    """Report Python, Blender, libraries, devices, torch, Ultralytics, disk; exit code 3 if a run would fail."""
    diagnosis = api.diagnose()
    found = table({f"{c.status:<7}  {c.name}": c.found for c in diagnosis.checks})
    todo = [f"-> {c.name}: {c.todo}" for c in diagnosis.checks if c.todo]
    show_result(session, diagnosis.to_json(), lambda: "\n".join([found, *todo]))
    if not diagnosis.ok:
        raise typer.Exit(ENVIRONMENT)
