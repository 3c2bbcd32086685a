"""Options of a command, read from its source: completion and hints import no command for them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

NUMBERS_OF_PLACE = 3  # words of a position, X Y Z
MANY_WORDS = 1000  # words of an option that takes any number


class Option(NamedTuple):
    """Option or positional argument of a command.

    Attributes:
        field: Name of its field.
        flags: Spellings, the main one first; none of a positional argument.
        words: Number of words that it takes; 0 of a switch, `MANY_WORDS` of a list.
        choices: Allowed values; none where any is.
        metavar: Name of its value, or nothing.
        help: Its explanation.
    """

    field: str
    flags: tuple[str, ...]
    words: int
    choices: tuple[str, ...]
    metavar: str
    help: str


class _Module(NamedTuple):
    """Parsed module: its own definitions, and where its imported names come from."""

    name: str
    docstring: str | None
    definitions: dict[str, ast.stmt]
    imports: dict[str, tuple[str, str]]


def read_options(module: str, name: str = "Options") -> list[Option]:
    """Return the options of a command in the order of its fields, and ``--help``.

    Args:
        module: Module of the command.
        name: Dataclass of its options.

    Returns:
        One for each field, those of base classes first; empty if the source is not there.
    """
    fields: dict[str, Option] = {}
    for home, item, text in _fields(module, name):
        option = _option(home, item, text)
        if option is not None:
            fields[option.field] = option
    if not fields:
        return []
    return [Option("help", ("--help", "-h"), 0, (), "", "Show this help."), *fields.values()]


def read_summary(module: str) -> str | None:
    """Return the first line of a module's docstring; None if its source is not there."""
    text = _parsed(module).docstring
    return None if text is None else text.partition("\n")[0]


def read_names(module: str, name: str) -> tuple[str, ...]:
    """Return the texts of a tuple, or the keys of a dictionary, that a module assigns to a name."""
    item = _parsed(module).definitions[name]
    value = item.value if isinstance(item, ast.Assign | ast.AnnAssign) else None
    parts = value.keys if isinstance(value, ast.Dict) else getattr(value, "elts", [])
    return tuple(str(part.value) for part in parts if isinstance(part, ast.Constant))


def read_texts(module: str, name: str) -> dict[str, str]:
    """Return a dictionary of texts that a module assigns to a name; empty if it has none."""
    item = _parsed(module).definitions.get(name)
    value = item.value if isinstance(item, ast.Assign | ast.AnnAssign) else None
    return {} if value is None else dict(ast.literal_eval(value))


def read_stems(package: str, folder: str, suffix: str) -> tuple[str, ...]:
    """Return the names, without suffix, of files in a folder of a package; none without it."""
    spec = find_spec(package)
    locations = (spec.submodule_search_locations or []) if spec is not None else []
    return tuple(
        sorted(path.stem for x in locations for path in Path(x, folder).glob(f"*{suffix}"))
    )


@lru_cache(maxsize=64)
def _parsed(module: str) -> _Module:
    """Parse a module without importing it."""
    source = _source(module)
    if source is None:
        return _Module(module, None, {}, {})
    tree = ast.parse(source.read_text(encoding="utf-8"))
    definitions: dict[str, ast.stmt] = {}
    imports: dict[str, tuple[str, str]] = {}
    for item in tree.body:
        if isinstance(item, ast.ClassDef):
            definitions[item.name] = item
        elif isinstance(item, ast.Assign) and isinstance(item.targets[0], ast.Name):
            definitions[item.targets[0].id] = item
        elif isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            definitions[item.target.id] = item
        elif isinstance(item, ast.ImportFrom) and item.module and not item.level:
            imports |= {a.asname or a.name: (item.module, a.name) for a in item.names}
    return _Module(module, ast.get_docstring(tree) or "", definitions, imports)


def _source(module: str) -> Path | None:
    """Return the file of a module, without importing the packages it is in; None if not there."""
    top, *rest = module.split(".")
    spec = find_spec(top)
    if spec is None:
        return None
    if not spec.submodule_search_locations:
        return Path(spec.origin) if spec.origin and not rest else None
    for location in spec.submodule_search_locations:
        path = Path(location).joinpath(*rest)
        for file in (path.with_suffix(".py"), path / "__init__.py"):
            if file.is_file():
                return file
    return None


def _find(module: _Module, name: str) -> tuple[_Module, ast.stmt] | None:
    """Find the definition of a name, through imports."""
    for _ in range(10):
        if name in module.definitions:
            return module, module.definitions[name]
        if name not in module.imports:
            return None
        source, name = module.imports[name]
        module = _parsed(source)
    return None


def _fields(module: str, name: str) -> Iterator[tuple[_Module, ast.AnnAssign, str]]:
    """Yield the annotated fields of a class and of its bases, with their docstrings."""
    place = _find(_parsed(module), name)
    if place is None:
        return
    home, item = place
    if not isinstance(item, ast.ClassDef):
        return
    for base in item.bases:
        if isinstance(base, ast.Name):
            yield from _fields(home.name, base.id)
    for k, line in enumerate(item.body):
        if isinstance(line, ast.AnnAssign):
            after = item.body[k + 1] if k + 1 < len(item.body) else None
            text = after.value if isinstance(after, ast.Expr) else None
            said = text.value if isinstance(text, ast.Constant) else ""
            yield home, line, " ".join(str(said).split())


def _option(home: _Module, item: ast.AnnAssign, text: str) -> Option | None:
    """Read one field; None if it is no option."""
    kind, marks = _unwrapped(home, item.annotation)
    if "ClassVar" in kind or not isinstance(item.target, ast.Name):
        return None
    field, flags, metavar, positional = item.target.id, list[str](), "", False
    main = field
    for mark in marks:
        positional |= ast.unparse(mark).endswith("Positional")
        for keyword in mark.keywords if isinstance(mark, ast.Call) else []:
            if keyword.arg == "name":
                main = ast.literal_eval(keyword.value)
            elif keyword.arg == "aliases":
                flags += ast.literal_eval(keyword.value)
            elif keyword.arg == "metavar":
                metavar = ast.literal_eval(keyword.value)
    flags.insert(0, f"--{main.replace('_', '-')}")
    words = _words(kind, marks)
    if kind == "bool" and words == 0:
        flags.append(f"--no-{main.replace('_', '-')}")
    choices: tuple[str, ...] = ()
    if kind.startswith("Literal["):
        choices = ast.literal_eval(f"({kind.removeprefix('Literal[').removesuffix(']')},)")
    return Option(field, () if positional else tuple(flags), words, choices, metavar, text)


def _unwrapped(home: _Module, annotation: ast.expr) -> tuple[str, list[ast.expr]]:
    """Return the type of a field as text, and what its annotation adds."""
    marks: list[ast.expr] = []
    while True:
        if isinstance(annotation, ast.Subscript) and ast.unparse(annotation.value) == "Annotated":
            inner = annotation.slice
            parts = inner.elts if isinstance(inner, ast.Tuple) else [inner]
            annotation, marks = parts[0], [*marks, *parts[1:]]
            continue
        place = _find(home, annotation.id) if isinstance(annotation, ast.Name) else None
        if place is None or not isinstance(place[1], ast.Assign):
            return ast.unparse(annotation), marks
        home, annotation = place[0], place[1].value


def _words(kind: str, marks: list[ast.expr]) -> int:
    """Return how many words an option takes."""
    texts = [ast.unparse(mark) for mark in marks]
    if kind == "bool" or "FlagCreatePairsOff" in kind:
        return 0
    if "POSITION_ARGUMENT" in texts:
        return NUMBERS_OF_PLACE
    if kind.startswith("tuple[") and kind.endswith("...]"):
        return 1 if any(text.endswith("UseAppendAction") for text in texts) else MANY_WORDS
    return 1
