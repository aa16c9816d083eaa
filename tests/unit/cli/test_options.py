"""Options that are made from the fields of requests."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import typer
from click.testing import Result
from typer.testing import CliRunner

from infrablend import api
from infrablend.cli.options import Fields, attribute_texts, with_options


@dataclass(frozen=True)
class Order:
    """What to make.

    Attributes:
        size: Length of the longest
            side, px.
        kind: Kind of thing.
        names: Names of the things [default: all].
        colours: Colour by name; repeatable.
        numbers: Number by name; repeatable.
        folder: Folder to read.
        loud: Say more.
        strict: Refuse odd things.
        parts: Parts; repeatable.
    """

    size: int
    kind: Literal["one", "two"] = "one"
    names: Sequence[str] | None = None
    colours: Mapping[str, str] = field(default_factory=dict)
    numbers: Mapping[str, Any] = field(default_factory=dict)
    folder: str | Path | None = None
    loud: bool = False
    strict: bool = True
    parts: Sequence[str] = ()


def call(*words: str, **options: Any) -> tuple[Result, list[Any]]:
    """Run a command with an option for every field of an order."""
    made = []

    def command(
        order: Annotated[
            Order, Fields("", parts=Annotated[list[str] | None, typer.Option("--part"), tuple], **options)
        ],
    ) -> None:
        """Make an order."""
        made.append(order)

    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command()(with_options(command))
    return CliRunner().invoke(app, list(words)), made


def test_every_field_is_an_option_with_type_default_and_help() -> None:
    shown = " ".join(call("--help")[0].output.split())
    for text in (
        "--size <int> Length of the longest side, px. [required]",
        "--kind <one|two> Kind of thing. [default: one]",
        "--names LIST Names of the things [default: all].",
        "--colours KEY=VALUE Colour by name; repeatable.",
        "--loud Say more.",
        "--strict / --no-strict Refuse odd things. [default: strict]",
    ):
        assert text in shown
    assert "Make an order." in shown and "--no-loud" not in shown


def test_options_become_the_request() -> None:
    words = "--size 3 --kind two --names a,b,a --colours a=red --numbers a=2 --numbers b=[1] --folder x --part p --loud"
    ended, made = call(*words.split(), "--no-strict")
    assert ended.exit_code == 0, ended.output
    wanted = Order(3, "two", ("a", "b"), {"a": "red"}, {"a": 2, "b": [1]}, Path("x"), True, False, ("p",))
    assert made == [wanted]
    assert call("--size", "3")[1] == [Order(3)]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "Missing option '--size'"),
        ("--size x", "Invalid value for '--size'"),
        ("--size 3 --kind three", "'three' is not one of 'one', 'two'"),
        ("--size 3 --names a,,b", "Invalid value for '--names': 'a,,b' has an empty item; write a,b,c"),
        ("--size 3 --colours a", "Invalid value for --colours: 'a': write KEY=VALUE, each key once"),
        ("--size 3 --numbers a=[", "Invalid value for --numbers: a=[: "),
        ("--size 0", "Invalid value for '--size': Input should be greater than or equal to 1"),
    ],
)
def test_wrong_values_name_their_option(words: str, message: str) -> None:
    ended, made = call(*words.split(), size=typer.Option(min=1))
    assert ended.exit_code == 2 and message in " ".join(ended.output.split()) and not made


def test_a_field_of_a_request_that_needs_more_is_in_a_dictionary() -> None:
    found = []

    def command(some: Annotated[dict[str, Any], Fields("kind loud", request=Order)], ctx: typer.Context) -> None:
        found.append((some, ctx.params))

    app = typer.Typer(add_completion=False)
    app.command()(with_options(command))
    assert CliRunner().invoke(app, ["--loud"]).exit_code == 0
    assert found == [({"kind": "one", "loud": True}, {"kind": "one", "loud": True})]


@pytest.mark.parametrize("name", [n for n in api.__all__ if n.endswith(("Request", "Settings", "Reading"))])
def test_the_docstrings_of_requests_explain_every_field(name: str) -> None:
    request = getattr(api, name)
    if hasattr(request, "__dataclass_fields__"):
        texts = attribute_texts(request)
        assert {f.name for f in fields(request)} == set(texts) and all(texts.values())
