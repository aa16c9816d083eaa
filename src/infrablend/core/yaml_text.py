"""Reading YAML that a person wrote, or that somebody hostile did: plain values only, nothing that grows."""

from __future__ import annotations

import re
from typing import Any

import yaml

MAX_CHARACTERS = 1_000_000
# Nested aliases multiply ("billion laughs"): what they stand for is counted as often as it is used.
MAX_VALUES = 100_000
MAX_DEPTH = 50


class _PlainLoader(yaml.SafeLoader):
    """YAML's plain values, less dates (a date is a text here), plus 1e9 as the number everybody means by it."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            if isinstance(key_node, yaml.ScalarNode) and key_node.tag != "tag:yaml.org,2002:merge":
                if key_node.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key {key_node.value!r} stands here twice", key_node.start_mark
                    )
                seen.add(key_node.value)
        return super().construct_mapping(node, deep)


_PlainLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:timestamp"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_PlainLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def read_yaml(text: str) -> Any:
    """The value in a YAML text: None, booleans, numbers, texts, lists and mappings of these with text keys.

    Raises:
        ValueError: Not YAML, a key twice, or a text built to exhaust memory; the message says which and where.
    """
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"{len(text)} characters of YAML; expected at most {MAX_CHARACTERS}")
    try:
        loader = _PlainLoader(text)
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            _count(node, {}, ())
            return _plain(loader.construct_document(node))
        finally:
            loader.dispose()
    except RecursionError as error:
        raise ValueError(f"nested too deeply; expected at most {MAX_DEPTH} levels") from error
    except yaml.YAMLError as error:
        where = " ".join(str(error).split()).replace('in "<unicode string>", ', "in ")
        raise ValueError(f"not YAML: {where}") from error


def _count(node: yaml.Node, known: dict[int, int], above: tuple[int, ...]) -> int:
    """How many values a node stands for, aliases written out."""
    if id(node) in above:
        raise ValueError("a value that contains itself; expected plain lists and mappings")
    if len(above) >= MAX_DEPTH:
        raise ValueError(f"nested too deeply; expected at most {MAX_DEPTH} levels")
    if id(node) not in known:
        inside: list[yaml.Node] = []
        if isinstance(node, yaml.SequenceNode):
            inside = list(node.value)
        elif isinstance(node, yaml.MappingNode):
            inside = [n for pair in node.value for n in pair]
        known[id(node)] = 1 + sum(_count(n, known, (*above, id(node))) for n in inside)
        if known[id(node)] > MAX_VALUES:
            raise ValueError(f"aliases that stand for more than {MAX_VALUES} values; write them out")
    return known[id(node)]


def _plain(value: Any) -> Any:
    """The value with texts for keys; whatever is neither number, text, list nor mapping is an error."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ValueError(f"a value of type {type(value).__name__}; expected plain numbers, texts, lists and mappings")
