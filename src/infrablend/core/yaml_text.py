"""Reads YAML 1.2 from untrusted text: plain values only, and nothing that exhausts memory."""

from __future__ import annotations

from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.resolver import VersionedResolver
from ruamel.yaml.tag import Tag

MAX_CHARACTERS = 1_000_000
# Nested aliases multiply ("billion laughs"): the values behind an alias count again each time it is used.
MAX_VALUES = 100_000
MAX_DEPTH = 50


class _DatesAreTexts(VersionedResolver):
    """YAML 1.2's types without dates: `2020-01-01` is a text."""

    def resolve(self, kind: Any, value: Any, implicit: Any) -> Any:
        tag = super().resolve(kind, value, implicit)
        return self.DEFAULT_SCALAR_TAG if str(tag) == "tag:yaml.org,2002:timestamp" else tag


def read_yaml(text: str, as_text: str | None = None) -> Any:
    """Return the value of a YAML text: None, booleans, numbers, texts, lists, and mappings with text keys.

    Args:
        text: The text.
        as_text: Key of the mapping below which scalars are texts, as they are written: `1e3` stays `1e3`.

    Raises:
        ValueError: If the text is not YAML, has a key twice, or is built to exhaust memory.
    """
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"{len(text)} characters of YAML; expected at most {MAX_CHARACTERS}")
    yaml = YAML(typ="safe", pure=True)
    yaml.Resolver = _DatesAreTexts
    yaml.composer.warn_double_anchors = False
    try:
        node = yaml.compose(text)
        if node is None:
            return None
        _count(node, {}, ())
        if as_text is not None and isinstance(node, MappingNode):
            for key, value in node.value:
                if isinstance(key, ScalarNode) and key.value == as_text and not _is_null(value):
                    _keep_text(value, set())
        return _plain(yaml.constructor.construct_document(node))
    except RecursionError as error:
        raise ValueError(f"nested too deeply; expected at most {MAX_DEPTH} levels") from error
    except YAMLError as error:
        raise ValueError(f"not YAML: {_describe(error)}") from error


def _is_null(node: Node) -> bool:
    return str(node.tag) == "tag:yaml.org,2002:null"


def _keep_text(node: Node, done: set[int]) -> None:
    """Make the values in a node texts, but not the keys of mappings."""
    if id(node) in done:
        return
    done.add(id(node))
    if isinstance(node, ScalarNode):
        if node.value and str(node.tag).startswith("tag:yaml.org,2002:"):  # other tags are refused
            node.ctag = Tag(suffix="tag:yaml.org,2002:str")
    elif isinstance(node, MappingNode):
        for _, value in node.value:
            _keep_text(value, done)
    elif isinstance(node, SequenceNode):
        for value in node.value:
            _keep_text(value, done)


def _describe(error: YAMLError) -> str:
    """Return the error and its place on one line, without the library's hints about its own settings."""
    problem = getattr(error, "problem", None)
    mark = getattr(error, "problem_mark", None)
    if problem is None or mark is None:
        return " ".join(str(error).split())
    context = getattr(error, "context", None)
    return f"{f'{context}, ' if context else ''}{problem} in line {mark.line + 1}, column {mark.column + 1}"


def _count(node: Node, known: dict[int, int], above: tuple[int, ...]) -> int:
    """Return the number of values of a node with all aliases written out."""
    if id(node) in above:
        raise ValueError("a value that contains itself; expected plain lists and mappings")
    if len(above) >= MAX_DEPTH:
        raise ValueError(f"nested too deeply; expected at most {MAX_DEPTH} levels")
    if id(node) not in known:
        inside: list[Node] = []
        if isinstance(node, SequenceNode):
            inside = list(node.value)
        elif isinstance(node, MappingNode):
            inside = [n for pair in node.value for n in pair]
        known[id(node)] = 1 + sum(_count(n, known, (*above, id(node))) for n in inside)
        if known[id(node)] > MAX_VALUES:
            raise ValueError(f"aliases that stand for more than {MAX_VALUES} values; write them out")
    return known[id(node)]


def _plain(value: Any) -> Any:
    """Return the value with texts as keys; a value that is no number, text, list or mapping is an error."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ValueError(f"a value of type {type(value).__name__}; expected plain numbers, texts, lists and mappings")
