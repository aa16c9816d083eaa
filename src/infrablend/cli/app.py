"""The command tree: names of the commands, and what all of them have in common."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from infrablend.cli import camera_commands, dataset_commands, exits, flight_commands, run_commands, shipped_commands
from infrablend.cli.call_state import open_session
from infrablend.cli.options import with_options
from infrablend.cli.output import print_json
from infrablend.core.addresses import require_folder, require_known
from infrablend.core.lazy_names import resolve
from infrablend.core.typed_command import set_typed_command, typed_command
from infrablend.errors import OutputError

_EPILOG = (
    "Exit codes: 0 done; 1 done, but some backgrounds or frames were skipped or failed, or nothing was inserted; 2 "
    "wrong command, recipe or data; 3 the environment (libraries, devices, disk, network); 130 stopped. 70 is a bug."
)

_Function = Callable[..., None]

COMMANDS: dict[str, _Function | str] = {
    "generate": run_commands.generate,
    "merge": run_commands.merge,
    "status": run_commands.status,
    "try": run_commands.try_recipe,
    "convert": dataset_commands.convert,
    "preview": run_commands.preview,
    "report": run_commands.report,
    "camera": camera_commands.camera,
    "profile": camera_commands.profile,
    "motion": camera_commands.find_motion,
    "rerender": run_commands.rerender,
    "show": run_commands.show,
    "exclude": run_commands.exclude,
    "include": run_commands.include,
    "inspect": dataset_commands.inspect,
    "check": dataset_commands.check,
    "split": dataset_commands.split,
    "train": "infrablend.lab.lab_commands:train",
    "realism": "infrablend.lab.lab_commands:realism",
    "evaluate": "infrablend.lab.lab_commands:evaluate",
    "experiment": "infrablend.lab.lab_commands:experiment",
    "detect": flight_commands.detect,
    "detectability": flight_commands.detectability,
    "frames": camera_commands.frames,
    "temperatures": camera_commands.temperatures,
    "world": "infrablend.lab.lab_commands:world",
    "fetch": dataset_commands.fetch,
    "studio": run_commands.studio,
    "doctor": shipped_commands.doctor,
}
"""Commands by name, in the order of the help. Those of the lab are names of functions: nothing here imports the lab."""
_GROUPS: dict[str, tuple[str, dict[str, _Function]]] = {
    "models": (
        "Object models.",
        {
            "list": shipped_commands.list_models,
            "describe": shipped_commands.describe_model,
            "show": shipped_commands.show_model,
            "add": shipped_commands.add_model,
        },
    ),
    "recipes": ("Shipped recipes.", {"list": shipped_commands.list_recipes, "show": shipped_commands.show_recipe}),
    "places": (
        "Places in pictures, where objects can stand.",
        {"map": camera_commands.map_places, "learn": camera_commands.learn_places},
    ),
    "blender": (
        "Blender, which few recipes need.",
        {"install": shipped_commands.install_blender, "requirements": shipped_commands.blender_requirements},
    ),
    "asset": ("Blender assets.", {"infrared-effect": shipped_commands.infrared_effect}),
}

# Parameters that may be addresses of object storage, by command; all other paths are on this machine.
_ADDRESSES = {
    "generate": {"data", "out"},
    "merge": {"sources", "data"},
    "status": {"out"},
    "rerender": {"data"},
    "exclude": {"data"},
    "include": {"data"},
}


class _Command(TyperCommand):
    """A command, which refuses addresses where it needs a folder before it reads or writes anything.

    Its options are made when it is first used: the requests that they come from may load NumPy.
    """

    def __init__(self, name: str, function: _Function | str) -> None:
        self._function: _Function = resolve(function) if isinstance(function, str) else function
        super().__init__(name, help=inspect.getdoc(self._function), rich_markup_mode=None)

    def make_context(self, *words: Any, **settings: Any) -> Any:
        if self.callback is None:
            alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
            alone.command(self.name)(with_options(self._function))
            made = get_command(alone)
            self.params = made.params
            self.callback = made.callback
        return super().make_context(*words, **settings)

    def invoke(self, ctx: Any) -> Any:
        ctx.obj.json = ctx.params.get("as_json", False)
        for param in self.params:
            found = ctx.params.get(param.name)
            for value in found if isinstance(found, list | tuple) else (found,):
                if isinstance(value, Path):
                    allowed = param.name in _ADDRESSES.get(self.name or "", ())
                    require = require_known if allowed else require_folder
                    require(_named(param), value)
        return super().invoke(ctx)


def _named(param: Any) -> str:
    """Return a parameter as help shows it: `--out`, or the name of an argument in capitals."""
    options = [o for o in param.opts if o.startswith("--")]
    return options[0] if options else str(param.metavar or param.name).rstrip(".")


class _Commands(TyperGroup):
    """The root command group, which reports the errors of all commands."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, function in COMMANDS.items():
            self.add_command(_Command(name, function))
        for group, (what, functions) in _GROUPS.items():
            inner = TyperGroup(name=group, help=what, no_args_is_help=True, rich_markup_mode=None)
            for name, function in functions.items():
                inner.add_command(_Command(name, function))
            self.add_command(inner)

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
    return app
