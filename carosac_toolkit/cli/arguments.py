"""Reader of the options after a command; a bad one gives a single clear message."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from difflib import get_close_matches
from pathlib import Path
from types import ModuleType, NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
)

from carosac_toolkit.base.errors import CarosacError, InvalidField, did_you_mean
from carosac_toolkit.cli.option_source import MANY_WORDS, read_options
from carosac_toolkit.robot.bundled_names import list_robots

_TYPE_DESCRIPTIONS: dict[type, tuple[str, str]] = {
    int: ("INT", "a whole number"),
    float: ("FLOAT", "a number"),
    str: ("TEXT", "a text"),
    Path: ("PATH", "a path"),
}


_REPEATABLE = get_args(tyro.conf.UseAppendAction[int])[1]
WORD_LETTERS_MIN = 4  # of an unknown option, to look for it in the help of others
SUGGESTIONS_MAX = 3
_RENAMED_OPTIONS = {"--suites": "--sensors", "--suite": "--sensors"}  # where a command has the new


def parse_options(module: ModuleType, name: str, words: Sequence[str]) -> Any:
    """Read the options of one command.

    Args:
        module: The command, with its ``Options``.
        name: Its name.
        words: Words after it on the command line.

    Returns:
        An instance of the command's ``Options``.

    Raises:
        CarosacError: A word that the command does not understand, or one that is missing.
        SystemExit: Help was asked for, and is printed.
    """
    _check_values_once(module.Options, words)
    registry = ConstructorRegistry()
    options = module.Options
    registry.primitive_rule(_number_or_nothing)
    registry.struct_rule(lambda info: _fields_in_words(options) if info.type is options else None)
    with _one_message(options, list(words)):
        return tyro.cli(
            options,
            args=words,
            prog=f"carosac {name}",
            description=module.__doc__,
            registry=registry,
        )


def _check_values_once(options: type, words: Sequence[str]) -> None:
    """Refuse an option of many values that comes twice: the first ones would be lost."""
    flags = [word.partition("=")[0] for word in words]
    for option in read_options(options.__module__, options.__name__):
        for flag in option.flags:
            if option.words == MANY_WORDS and flags.count(flag) > 1:
                allowed = f"one {flag} with all its values behind it"
                raise InvalidField(flag, f"{flags.count(flag)} times", allowed)


def _fields_in_words(options: type) -> StructConstructorSpec:
    """Explain options in unbroken sentences, with those defaults that say something."""
    known = read_options(options.__module__, options.__name__)
    words = {option.field: option.help for option in known}
    hints = get_type_hints(options, include_extras=True)
    annotated: Any = Annotated  # built here, for no type checker
    specs = []
    for field in fields(options):
        marks = getattr(hints[field.name], "__metadata__", ())
        hinted = any(getattr(mark, "help_behavior_hint", None) is not None for mark in marks)
        told = None if hinted or _REPEATABLE in marks else _default_in_words
        text = tyro.conf.arg(help=words.get(field.name), help_behavior_hint=told)
        default = tyro.MISSING if field.default is dataclasses.MISSING else field.default
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        kind = annotated[hints[field.name], text]
        specs.append(StructFieldSpec(name=field.name, type=kind, default=default))
    return StructConstructorSpec(instantiate=options, fields=tuple(specs))


def _default_in_words(text: str) -> str:
    """Name a default, unless it only says that nothing was asked for."""
    return "" if text in ("", "none", "None", "False") else f"(default: {text})"


def _number_or_nothing(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Show and read numbers and optional values plainly, never as ``{None}|INT``."""
    union = get_origin(info.type) in (Union, UnionType)  # the arguments of a tuple are no choices
    kinds = set(get_args(info.type)) if union else {info.type}
    plain = kinds - {NoneType}
    kind = plain.pop() if len(plain) == 1 else None
    if kind not in _TYPE_DESCRIPTIONS or (kinds == {kind} and kind not in (int, float)):
        return None
    metavar, allowed = _TYPE_DESCRIPTIONS[kind]

    def read(words: list[str]) -> Any:
        try:
            return kind(words[0])
        except ValueError as error:
            raise ValueError(allowed) from error

    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, tuple(kinds)),
        str_from_instance=lambda value: ["none" if value is None else str(value)],
    )


@contextlib.contextmanager
def _one_message(options: type, words: list[str]) -> Iterator[None]:
    """Turn tyro's error boxes into our errors; a tyro without the hook keeps its boxes."""
    errors = getattr(tyro, "_errors", None)  # its hook, since 1.0.17, has no public name yet
    hook: Callable[..., Any] | None = getattr(errors, "on_parse_error", None)
    if hook is None:
        yield
        return

    def refuse(event: Any) -> None:
        answer = _ERROR_BUILDERS.get(type(event).__name__)
        if answer is not None:
            raise answer(event, options, words)

    with hook(refuse):
        yield


def _unrecognized(event: Any, options: type, words: list[str]) -> CarosacError:
    """Return the error for an option or argument that the command does not have."""
    token = str(event.tokens[0])
    if not token.startswith("-"):
        hint = _robot_hint(token, options)
        allowed = f"nothing more{hint}; see '{event.prog} --help'"
        return InvalidField("argument", repr(token), allowed)
    flag = token.partition("=")[0]
    known = ["--help", *(f"--{name.replace('_', '-')}" for name in _names(options))]
    options_only = [name for name in known if name not in _positionals(options)]
    if _RENAMED_OPTIONS.get(flag) in options_only:
        return CarosacError(f"{flag} is now {_RENAMED_OPTIONS[flag]}")
    allowed = f"{', '.join(options_only)}{_nearest_options(flag, options, options_only[1:])}"
    return InvalidField("option", repr(token), allowed)


def _robot_hint(token: str, options: type) -> str:
    """Ask whether a word is meant as the robot, where that is an option."""
    flags = {
        flag
        for option in read_options(options.__module__, options.__name__)
        for flag in option.flags
    }
    named = token in list_robots() or token.lower().endswith((".yaml", ".yml"))
    return f"; did you mean '--robot {token}'?" if named and "--robot" in flags else ""


def _nearest_options(flag: str, options: type, known: Sequence[str]) -> str:
    """Ask for options with a name like this one, or with this word in their help."""
    word = flag.strip("-")
    if word in ("h", "hel", "helps"):
        known = ["--help", *known]
    near = get_close_matches(word, [name.strip("-") for name in known], n=1, cutoff=0.6)
    if not near and len(word) >= WORD_LETTERS_MIN:
        stem = re.escape(word.removesuffix("s"))
        near = [
            option.flags[0].strip("-")
            for option in read_options(options.__module__, options.__name__)
            if option.flags
            and option.flags[0] in known
            and re.search(rf"\b{stem}s?\b", option.help, re.IGNORECASE)
        ]
    shown = [f"'--{name}'" for name in near[:SUGGESTIONS_MAX]]
    return f"; did you mean {' or '.join(shown)}?" if shown else ""


def _missing(event: Any, options: type, words: list[str]) -> CarosacError:
    """Return the error for a required argument that is missing."""
    missing = [entry.arg for entry in event.missing_arguments]
    choices = missing[0].lowered.choices if len(missing) == 1 else None
    allowed = f"one of {', '.join(choices)}" if choices else "a value"
    names = " and ".join(map(_spelling, missing))
    return InvalidField(names, "nothing", f"{allowed}; see '{event.prog} --help'")


def _bad_value(event: Any, options: type, words: list[str]) -> CarosacError:
    """Return the error for an option without its value."""
    flag, metavar = _spelling(event.argument), str(event.argument.lowered.metavar or "")
    given = _written_after(flag, words)
    if not given:
        return InvalidField(flag, "nothing", f"a value; see '{event.prog} --help'")
    return InvalidField(flag, repr(" ".join(given)), f"{metavar}; see '{event.prog} --help'")


def _invalid_choice(event: Any, options: type, words: list[str]) -> CarosacError:
    """Return the error for a value that is not among the choices."""
    allowed = f"one of {', '.join(event.choices)}{did_you_mean(event.value, event.choices)}"
    return InvalidField(_spelling(event.argument), repr(event.value), allowed)


def _failure(event: Any, options: type, words: list[str]) -> CarosacError:
    """Return the error for a value that cannot be parsed."""
    if event.argument is None:
        return CarosacError(str(event.message))
    flag = _spelling(event.argument)
    return InvalidField(flag, _written(flag, words), str(event.message))


_ERROR_BUILDERS: dict[str, Callable[[Any, type, list[str]], CarosacError]] = {
    "UnrecognizedArgs": _unrecognized,
    "MissingArgs": _missing,
    "BadValue": _bad_value,
    "InvalidChoice": _invalid_choice,
    "InstantiationFailure": _failure,
}


def _spelling(argument: Any) -> str:
    """Return the option as users write it; a positional argument by its metavar."""
    if argument.is_positional():
        return str(argument.lowered.metavar)
    return str(argument.lowered.name_or_flags[-1])


def _written(flag: str, words: list[str]) -> str:
    """Return what the user wrote for an option."""
    for k, word in enumerate(words):
        if word == flag and k + 1 < len(words):
            return repr(words[k + 1])
        if word.startswith(f"{flag}="):
            return repr(word.partition("=")[2])
    return "a value"


def _written_after(flag: str, words: list[str]) -> list[str]:
    """Return the values that the user wrote for an option."""
    given: list[str] = []
    for word in words[words.index(flag) + 1 :] if flag in words else []:
        if word.startswith("--"):
            break
        given.append(word)
    return given


def _names(options: type) -> list[str]:
    """Return the names of the options as users write them, without dashes."""
    hints = get_type_hints(options, include_extras=True)
    flags = []
    for field in fields(options):
        marks = getattr(hints[field.name], "__metadata__", ())
        names = [mark.name for mark in marks if getattr(mark, "name", None)]
        flags.append(names[0] if names else field.name)
    return flags


def _positionals(options: type) -> set[str]:
    """Return the flags that positional arguments would have as options."""
    marker = get_args(tyro.conf.Positional[int])[1]
    hints = get_type_hints(options, include_extras=True)
    return {
        f"--{name.replace('_', '-')}" for name, hint in hints.items() if marker in get_args(hint)
    }
