"""Read YAML 1.2 into plain data, and remember the line of every value.

Only plain values are built: mappings, lists, numbers, booleans, null and text. Numbers are decimal
(``1:30`` and ``0x10`` stay text), and ``true`` and ``false`` alone are booleans, so that a surprise
of YAML ends in a clear message about its field.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from ruamel.yaml import YAML, MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.composer import MaxDepthExceededError
from ruamel.yaml.error import (
    MarkedYAMLError,
    ReusedAnchorWarning,
    YAMLError,
)

FieldPath = tuple[str | int, ...]
_MAX_VALUES = 100_000
CHARACTERS_MAX = 200_000  # of a text; the reader takes 15 us for each
_DEPTH_MAX = 64  # of mappings and lists inside each other; robot files have 5
_UNINDENTED = ("expected key", "block end", "'-' indicator", "document start")


@dataclass
class Document:
    """A YAML file as data.

    Attributes:
        data: Mappings, lists and scalars; None where the text is no YAML.
        lines: Line of every value (of the key, in a mapping), from 1, by path.
        faults: What is wrong with the text itself, as (line, message).
    """

    data: Any = None
    lines: dict[FieldPath, int] = field(default_factory=dict)
    faults: list[tuple[int, str]] = field(default_factory=list)

    def line(self, path: FieldPath) -> int:
        """Line of a value, or of the nearest value around it that is in the file."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 1)


def read_yaml(text: str) -> Document:
    """Read one YAML document; what is wrong with it is in the result, never raised.

    Tabs after the first word of a line count as spaces.
    """
    document = Document()
    if len(text) > CHARACTERS_MAX:
        fault = f"not usable: {len(text)} characters; allowed: {CHARACTERS_MAX}"
        return Document(faults=[(1, fault)])
    try:
        node = _compose(re.sub(r"(?<=\S)[ \t]+", lambda gap: " " * len(gap[0]), text))
        if node is None:
            document.faults.append((1, "the file is empty"))
        else:
            document.lines[()] = node.start_mark.line + 1
            document.data = _build(node, (), document)
    except MaxDepthExceededError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        fault = f"not usable: nested more than {_DEPTH_MAX} levels deep"
        document.faults.append((line, fault))
    except MarkedYAMLError as error:
        document.faults.append(_syntax_fault(error, text.splitlines()))
    except ReusedAnchorWarning as error:
        line = int(re.findall(r"line (\d+)", str(error))[-1])
        document.faults.append((line, "not YAML: an anchor of this name stands further up"))
    except YAMLError as error:
        document.faults.append((1, f"not YAML: {str(error).splitlines()[0]}"))
    except RecursionError:
        document.faults.append((1, "not usable: it is nested too deeply, or contains itself"))
    return document


def load_yaml(text: str) -> Any:
    """Return the plain data of a YAML text of our own, with whole numbers as int.

    Raises:
        YAMLError: The text is no YAML, or names a key twice.
    """
    return YAML(typ="safe", pure=True).load(text)


def dump_yaml(data: Any) -> str:
    """Return data as YAML in the style of the bundled files."""
    stream = io.StringIO()
    round_trip().dump(data, stream)
    return stream.getvalue()


def round_trip() -> YAML:
    """Return a reader and writer that keeps comments, order and quotes of a file."""
    yaml = YAML()
    yaml.width = 4096
    yaml.indent(mapping=2, sequence=4, offset=2)
    yaml.preserve_quotes = True
    return yaml


def walk(path: FieldPath, value: Any) -> Iterator[tuple[FieldPath, Any]]:
    """Yield all paths below a value, each with what is there; outer ones first."""
    entries: list[tuple[str | int, Any]] = []
    if isinstance(value, dict):
        entries = list(value.items())
    elif isinstance(value, list):
        entries = list(enumerate(value))
    for key, entry in entries:
        yield (*path, key), entry
        yield from walk((*path, key), entry)


def format_path(path: FieldPath) -> str:
    """Write a path as users read it: ``chains[2].cable``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text or "(whole file)"


def _compose(text: str) -> Node | None:
    """Return the tree of a document; an anchor that is given twice is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", ReusedAnchorWarning)
        yaml = YAML(typ="safe", pure=True)
        yaml.max_depth = _DEPTH_MAX
        node: Node | None = yaml.compose(text)
        return node


def _syntax_fault(error: MarkedYAMLError, lines: list[str]) -> tuple[int, str]:
    """Turn a parser error into a line and one sentence."""
    mark = error.problem_mark or error.context_mark
    what = error.problem or "a syntax error"
    context = f" ({error.context})" if error.context else ""
    if mark is None:
        return 1, f"not YAML: {what}{context}"
    number = min(mark.line, len(lines) - 1)
    tab = _tab_line(lines, number)
    if tab is not None:
        return tab + 1, "a tab before the first word; YAML indents with spaces"
    reason = _misindented(what, lines, number)
    if reason is not None:
        return number + 1, f"wrong indentation: {reason}"
    return mark.line + 1, f"not YAML: column {mark.column + 1}: {what}{context}"


def _tab_line(lines: list[str], number: int) -> int | None:
    """Index of the line with a tab in its indentation: this one, or the one before it."""
    for k in (number, number - 1):
        if k >= 0 and "\t" in lines[k][: len(lines[k]) - len(lines[k].lstrip())]:
            return k
    return None


def _misindented(what: str, lines: list[str], number: int) -> str | None:
    """Say how a line is indented wrongly, where that is what the parser stumbles over."""
    above = next((k for k in range(number - 1, -1, -1) if _content(lines[k])), None)
    line = lines[number] if number >= 0 else ""
    if above is None or not _content(line):
        return None
    depth, outer = _depth(line), _depth(lines[above])
    begun = f"{depth} space{'s' if depth != 1 else ''} here, {outer} in line {above + 1}"
    if what.startswith("mapping values are not allowed") and depth > outer:
        if line[depth:].count(": ") + line.rstrip().endswith(":") == 1:
            return f"{begun}, which has a value already; entries of one mapping start alike"
    if any(word in what for word in _UNINDENTED):
        levels = {_depth(text) for text in lines[:number] if _content(text)}
        if depth not in levels:
            known = ", ".join(str(level) for level in sorted(levels))
            return f"{begun}; the lines above start after {known} spaces"
        if depth != outer and not lines[above].rstrip().endswith((":", ",", "[", "{")):
            return f"{begun}; entries of one mapping start alike"
    return None


def _content(line: str) -> bool:
    """Return whether a line holds more than a comment."""
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _depth(line: str) -> int:
    """Spaces before the first word."""
    return len(line) - len(line.lstrip(" "))


def _build(node: Node, path: FieldPath, document: Document) -> Any:
    """Build the value of a node, noting lines and duplicate keys."""
    document.lines.setdefault(path, node.start_mark.line + 1)
    if len(document.lines) > _MAX_VALUES:
        raise RecursionError
    if isinstance(node, MappingNode):
        return _build_mapping(node, path, document)
    if isinstance(node, SequenceNode):
        return [_build(item, (*path, i), document) for i, item in enumerate(node.value)]
    return _scalar(node)


def _build_mapping(node: MappingNode, path: FieldPath, document: Document) -> dict[str, Any]:
    """Build a mapping; its keys are text."""
    result: dict[str, Any] = {}
    for key_node, value_node in node.value:
        line = key_node.start_mark.line + 1
        if not isinstance(key_node, ScalarNode):
            document.faults.append((line, f"{format_path(path)}: a key must be a name"))
            continue
        key = str(key_node.value)
        here = (*path, key)
        if key in result:
            first = document.lines[here]
            document.faults.append(
                (line, f"{format_path(here)}: given twice, first in line {first}; allowed: once")
            )
            continue
        document.lines[here] = line
        result[key] = _build(value_node, here, document)
    return result


def _scalar(node: Node) -> Any:
    """Build null, a boolean, a decimal number or text."""
    text = str(node.value)
    kind = str(node.tag).rpartition(":")[2]
    if kind == "null":
        return None
    if kind == "bool":
        return {"true": True, "false": False}.get(text.lower(), text)
    if kind in ("int", "float"):
        try:
            return float(text.replace(".inf", "inf").replace(".nan", "nan"))
        except ValueError:
            return text
    return text
