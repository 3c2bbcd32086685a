"""Errors over fields of the library, told by the options that set them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.cli.option_source import MANY_WORDS, Option, read_options
from carosac_toolkit.loop.plugin_settings import SET_OPTION

LIMIT_SUFFIX = "_max"  # of fields whose options have none: --speed sets speed_max
OPTION_NAMES = {"estimator": "models"}  # of fields that a command sets by an option of another name
_SETTINGS_FIELD = re.compile(r"(controller|estimator|driver)(?:_settings)?(?: of |(?=\.))")


def name_option(error: InvalidField, options: object, words: Sequence[str]) -> InvalidField:
    """Return the error with the option instead of the field, if the user wrote its value there.

    Args:
        error: What a command raised.
        options: Options of the command.
        words: Words after the command.
    """
    if type(error) is not InvalidField or error.field.startswith("--"):
        return error
    setting = _SETTINGS_FIELD.match(error.field)
    if setting is not None and any(word.partition("=")[0] == SET_OPTION for word in words):
        return InvalidField(_setting(error.field, setting, options), error.value, error.allowed)
    kind = type(options)
    for option in read_options(kind.__module__, kind.__name__):
        name = _spelling(option, error.field, str(error.value), words)
        if name is not None:
            return _renamed(error, option, name)
    return error


def _setting(field: str, match: re.Match[str], options: object) -> str:
    """Return a field of a plug-in's settings as --set has it."""
    kind, rest = match[1], field[match.end() :].lstrip(".")
    if kind == "driver" and " of " in match[0]:
        rest = rest.removeprefix(str(getattr(options, "driver", ""))).lstrip(".")
    return f"{SET_OPTION} {'.'.join(filter(None, (kind, rest)))}"


def _spelling(option: Option, field: str, value: str, words: Sequence[str]) -> str | None:
    """Return the option as the user wrote it if it sets this field to this value; else None."""
    if not option.flags:
        named = option.metavar.lower() == field and _same(value, words)
        return option.metavar if named else None
    names = {field, f"{field}s", field.removesuffix(LIMIT_SUFFIX), OPTION_NAMES.get(field, field)}
    if not {f"--{name.replace('_', '-')}" for name in names} & set(option.flags):
        return None
    for flag in option.flags:
        if _same(value, list(_values_of(flag, words))):
            return flag
    return None


def _values_of(flag: str, words: Sequence[str]) -> Iterator[str]:
    """Yield the values that the user wrote for an option."""
    taken = False
    for word in words:
        name, equals, value = word.partition("=")
        if word.startswith("--"):
            taken = name == flag
            if taken and equals:
                yield value
        elif taken:
            yield word


def _same(value: str, words: Sequence[str]) -> bool:
    """Return whether a value in a message, with its quotes or unit, is one of some words."""
    text = value.strip("'\"") if value[:1] in "'\"" else value.partition(" ")[0]
    return any(text in (word, _as_float(word)) for word in words)


def _as_float(word: str) -> str:
    try:
        return str(float(word))
    except ValueError:
        return word


def _renamed(error: InvalidField, option: Option, name: str) -> InvalidField:
    """Return the error with another name of the field."""
    text = str(error.value).strip("'\"")
    if option.words == MANY_WORDS and "," in text:
        parts = " ".join(part.strip() for part in text.split(","))
        return InvalidField(name, error.value, f"names with spaces between them: {name} {parts}")
    allowed = error.allowed
    if "_" in error.field:  # a word of its own, not one of the sentence
        allowed = re.sub(rf"\b{re.escape(error.field)}\b", name, allowed)
    return InvalidField(name, error.value, allowed)
