"""The command tree: names of the commands, which have modules of their own."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from infrablend.cli import (
    asset,
    check,
    convert,
    doctor,
    evaluate,
    exclude,
    exits,
    experiment,
    fetch,
    frames,
    generate,
    inspect,
    merge,
    models,
    preview,
    profile,
    realism,
    recipes,
    report,
    rerender,
    show,
    split,
    status,
    studio,
    submit,
    temperatures,
    train,
    try_recipe,
    world,
)
from infrablend.cli.session import open_session
from infrablend.core.addresses import require_folder, require_known
from infrablend.core.typed_command import set_typed_command, typed_command
from infrablend.errors import OutputError

_EPILOG = (
    "Exit codes: 0 done; 1 done, but some backgrounds or frames were skipped or failed; 2 wrong command, recipe "
    "or data; 3 the environment (libraries, devices, disk, network); 130 stopped. 70 is a bug."
)


# Parameters that may be addresses of object storage, by command; all other paths are on this machine.
_ADDRESSES = {
    "generate": {"data", "out"}, "merge": {"sources", "data"}, "status": {"out"}, "rerender": {"data"},
    "exclude": {"data"}, "include": {"data"},
}  # fmt: skip


class _Command(TyperCommand):
    """A command, which refuses addresses where it needs a folder before it reads or writes anything."""

    def invoke(self, ctx: Any) -> Any:
        for param in self.params:
            found = ctx.params.get(param.name)
            for value in found if isinstance(found, list | tuple) else (found,):
                if isinstance(value, Path):
                    allowed = param.name in _ADDRESSES.get(self.name or "", ())
                    (require_known if allowed else require_folder)(_named(param), value)
        return super().invoke(ctx)


def _named(param: Any) -> str:
    """Return a parameter as help shows it: `--out`, or the name of an argument in capitals."""
    options = [o for o in param.opts if o.startswith("--")]
    return options[0] if options else str(param.metavar or param.name).rstrip(".")


class _Commands(TyperGroup):
    """The root command group, which reports the errors of all commands."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        set_typed_command(args)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        try:
            with typed_command():
                return super().invoke(ctx)
        except (typer.Exit, typer.Abort, BrokenPipeError):
            raise
        except (Exception, KeyboardInterrupt) as e:
            if hasattr(e, "exit_code"):  # wrong usage: the parser reports it
                raise
            raise typer.Exit(_report(e, ctx)) from e


def _report(error: BaseException, ctx: Any) -> int:
    session = ctx.obj
    code = exits.report_error(error, session.log_path if session else None)
    if session and session.json and code != exits.INTERRUPTED:
        from infrablend.cli.results import print_json

        problems = [p.to_json() for p in getattr(error, "problems", ())]
        message = getattr(error, "message", str(error))
        with contextlib.suppress(OutputError):  # stdout cannot be written; reported on stderr
            print_json({"error": type(error).__name__, "message": message, "problems": problems, "exit_code": code})
    return code


def _version(wanted: bool) -> None:
    if wanted:
        from infrablend import __version__

        typer.echo(f"infrablend {__version__}")
        raise typer.Exit


def _root(
    ctx: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log more on stderr.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress on stderr.")] = False,
    log: Annotated[
        Path | None, typer.Option(help="Log file [default: $INFRABLEND_LOG or the user's state folder].")
    ] = None,
) -> None:
    """Put rendered thermal objects into real thermal aerial images, with boxes, oriented boxes and masks."""
    ctx.obj = ctx.with_resource(open_session(verbose, quiet, log))


def build_app() -> typer.Typer:
    """Return the whole command line."""
    app = typer.Typer(
        name="infrablend",
        cls=_Commands,
        add_completion=True,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        epilog=_EPILOG,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    app.command("generate", cls=_Command)(generate.generate)
    app.command("merge", cls=_Command)(merge.merge)
    app.command("status", cls=_Command)(status.status)
    app.command("submit", cls=_Command)(submit.submit)
    app.command("try", cls=_Command)(try_recipe.try_recipe)
    app.command("convert", cls=_Command)(convert.convert)
    app.command("preview", cls=_Command)(preview.preview)
    app.command("report", cls=_Command)(report.report)
    app.command("profile", cls=_Command)(profile.profile)
    app.command("rerender", cls=_Command)(rerender.rerender)
    app.command("show", cls=_Command)(show.show)
    app.command("exclude", cls=_Command)(exclude.exclude)
    app.command("include", cls=_Command)(exclude.include)
    app.command("inspect", cls=_Command)(inspect.inspect)
    app.command("check", cls=_Command)(check.check)
    app.command("split", cls=_Command)(split.split)
    app.command("train", cls=_Command)(train.train)
    app.command("realism", cls=_Command)(realism.realism)
    app.command("evaluate", cls=_Command)(evaluate.evaluate)
    app.command("experiment", cls=_Command)(experiment.experiment)
    app.command("frames", cls=_Command)(frames.frames)
    app.command("temperatures", cls=_Command)(temperatures.temperatures)
    app.command("world", cls=_Command)(world.world)
    app.command("fetch", cls=_Command)(fetch.fetch)
    app.command("studio", cls=_Command)(studio.studio)
    app.command("doctor", cls=_Command)(doctor.doctor)
    groups: tuple[tuple[str, dict[str, Callable[..., None]], str], ...] = (
        (
            "models",
            {
                "list": models.list_models,
                "describe": models.describe_model,
                "show": models.show_model,
                "add": models.add_model,
            },
            "Object models.",
        ),
        ("recipes", {"list": recipes.list_recipes, "show": recipes.show_recipe}, "Shipped recipes."),
        ("asset", {"infrared-effect": asset.infrared_effect}, "Blender assets."),
    )
    for name, commands, what in groups:
        group = typer.Typer(name=name, help=what, no_args_is_help=True, rich_markup_mode=None)
        for command, function in commands.items():
            group.command(command, cls=_Command)(function)
        app.add_typer(group)
    return app
