"""Read YAML into plain data, and remember the line of every value.

Only plain values are built: mappings, lists, numbers, booleans, null and text. Numbers are decimal
(``1:30`` stays text), so that a surprise of YAML 1.1 ends in a clear message about its field.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, field
from typing import Any

import yaml

FieldPath = tuple[str | int, ...]
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_MAX_VALUES = 100_000
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
    """Read one YAML document; what is wrong with it is in the result, never raised."""
    document = Document()
    try:
        node = yaml.compose(text, Loader=_LOADER)
    except yaml.MarkedYAMLError as error:
        document.faults.append(_syntax_fault(error, text.splitlines()))
        return document
    except yaml.YAMLError as error:
        document.faults.append((1, f"not YAML: {str(error).splitlines()[0]}"))
        return document
    if node is None:
        document.faults.append((1, "the file is empty"))
        return document
    document.lines[()] = node.start_mark.line + 1
    try:
        document.data = _build(node, (), document)
    except RecursionError:
        document.faults.append((1, "not usable: it is nested too deeply, or contains itself"))
    return document


def format_path(path: FieldPath) -> str:
    """Write a path as users read it: ``chains[2].cable``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text or "(whole file)"


def nearest(word: str, words: list[str]) -> str | None:
    """Find the most similar word, if one is similar."""
    near = difflib.get_close_matches(word, words, n=1, cutoff=0.6)
    return near[0] if near else None


def did_you_mean(word: str, words: list[str]) -> str:
    """Name the most similar word, as ``; did you mean 'x'``, or nothing."""
    near = nearest(word, words)
    return f"; did you mean '{near}'" if near else ""


def _syntax_fault(error: yaml.MarkedYAMLError, lines: list[str]) -> tuple[int, str]:
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
    """Whether a line holds more than a comment."""
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _depth(line: str) -> int:
    """Spaces before the first word."""
    return len(line) - len(line.lstrip(" "))


def _build(node: yaml.Node, path: FieldPath, document: Document) -> Any:
    """Build the value of a node, noting lines and duplicate keys."""
    document.lines.setdefault(path, node.start_mark.line + 1)
    if len(document.lines) > _MAX_VALUES:
        raise RecursionError
    if isinstance(node, yaml.MappingNode):
        return _build_mapping(node, path, document)
    if isinstance(node, yaml.SequenceNode):
        return [_build(item, (*path, i), document) for i, item in enumerate(node.value)]
    return _scalar(node)


def _build_mapping(node: yaml.MappingNode, path: FieldPath, document: Document) -> dict[str, Any]:
    """Build a mapping; its keys are text."""
    result: dict[str, Any] = {}
    for key_node, value_node in node.value:
        line = key_node.start_mark.line + 1
        if not isinstance(key_node, yaml.ScalarNode):
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


def _scalar(node: yaml.Node) -> Any:
    """Build null, a boolean, a decimal number or text."""
    text = str(node.value)
    kind = node.tag.rpartition(":")[2]
    if kind == "null":
        return None
    if kind == "bool":
        return text.lower() in ("true", "yes", "on")
    if kind in ("int", "float"):
        try:
            return float(text.replace(".inf", "inf").replace(".nan", "nan"))
        except ValueError:
            return text
    return text
