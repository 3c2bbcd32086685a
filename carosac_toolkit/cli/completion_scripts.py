"""Completion scripts of bash, zsh and fish, written from the options of all commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from carosac_toolkit.cli.completion_words import (
    ANY_FILE,
    FOLDER,
    Described,
    Values,
    values_of,
)
from carosac_toolkit.cli.option_source import MANY_WORDS, Option

MAIN_OPTIONS = ("--help", "--version")
HELP_CHARACTERS_MAX = 70  # shown beside an option
_SHELL_CHARACTERS = str.maketrans({"[": "(", "]": ")", **dict.fromkeys("`'\"\\$!", "")})

_BASH = r"""# completion of carosac for bash; made by: carosac completion bash
_carosac() {
  local current="${COMP_WORDS[COMP_CWORD]}" command="${COMP_WORDS[1]}" first=2
  local option="" taken=0 words=0 names="" files="" flags="" kind="-f" k word IFS=$'\n'
  COMPREPLY=()
  [[ $current == "=" ]] && current=""
  if (( COMP_CWORD == 1 )); then
    COMPREPLY=($(compgen -W $'@TOP@' -- "$current")); return
  fi
  case "$command" in
@GROUPS@
  esac
  for (( k = first; k < COMP_CWORD; k++ )); do
    word="${COMP_WORDS[k]}"
    if [[ $word == -* ]]; then option="$word"; taken=0
    elif [[ $word != "=" ]]; then (( taken++ )); fi
  done
  case "$command" in
@FLAGS@
  esac
  case "$command $option" in
@VALUES@
  esac
  if [[ $current == -* ]] || (( taken >= words )); then
    words=0; names=""; files=""
    case "$command" in
@POSITIONALS@
    esac
    [[ $current == -* || -z $names$files ]] && COMPREPLY=($(compgen -W "$flags" -- "$current"))
    [[ $current == -* ]] && return
  fi
  COMPREPLY+=($(compgen -W "$names" -- "$current"))
  [[ -z $files ]] && return
  compopt -o filenames 2>/dev/null
  if [[ $files == "/" ]]; then
    kind="-d"
  fi
  while IFS= read -r word; do
    [[ $files == [/*] || -d $word || " $files " == *" ${word##*.} "* ]] && COMPREPLY+=("$word")
  done < <(compgen "$kind" -- "$current")
}
complete -F _carosac carosac"""

_ZSH = r"""#compdef carosac
# completion of carosac for zsh; made by: carosac completion zsh
_carosac() {
  local -a commands
  if (( CURRENT == 2 )); then
    commands=(
@TOP@
    )
    _describe -t commands command commands
    return
  fi
  shift words; (( CURRENT-- ))
  case "$words[1]" in
@GROUPS@
  esac
  case "$words[1]" in
@ARGUMENTS@
  esac
}
if [[ $funcstack[1] == _carosac ]]; then _carosac "$@"; else compdef _carosac carosac; fi"""

_FISH = r"""# completion of carosac for fish; made by: carosac completion fish
function __carosac_command
  set -l words (commandline -opc)
  set -e words[1]
  set -l wanted (string split ' ' -- $argv[1])
  test (count $words) -ge (count $wanted); or return 1
  test "$words[1..$(count $wanted)]" = "$argv[1]"
end
function __carosac_takes
  __carosac_command $argv[1]; or return 1
  set -l words (commandline -opc)
  set -l last ''
  for word in $words
    string match -q -- '-*' $word; and set last $word
  end
  contains -- $last $argv[2..]
end
function __carosac_files
  set -l current (commandline -ct)
  for file in $current*
    test -d $file; and echo $file/; and continue
    contains -- (string replace -r '.*\.' '' -- $file) $argv; and echo $file
  end
end
complete -c carosac -f
@LINES@"""


def bash_script(commands: Sequence[Described]) -> str:
    """Write the completion of bash."""
    groups, flags, values, positionals = [], [], [], []
    for group, members in _groups(commands).items():
        groups.append(
            f"    {group}) if (( COMP_CWORD == 2 )); then\n      COMPREPLY=($(compgen -W "
            f"$'{_lines(members)}' -- \"$current\")); return\n      fi\n"
            f'      command="$command ${{COMP_WORDS[2]}}"; first=3 ;;'
        )
    for command in commands:
        every = [flag for option in command.options for flag in option.flags if flag != "-h"]
        flags.append(f"    '{command.name}') flags=$'{_lines(every)}' ;;")
        for option in command.options:
            given = values_of(option)
            assigned = f"names=$'{_lines(given.names)}' files='{' '.join(given.files)}'"
            if not option.flags:
                positionals.append(f"      '{command.name}') {assigned} ;;")
            elif option.words:
                pattern = "|".join(f"'{command.name} {flag}'" for flag in option.flags)
                values.append(f"    {pattern}) words={option.words} {assigned} ;;")
    return _filled(
        _BASH, TOP=_lines([*_top(commands), *MAIN_OPTIONS]), GROUPS="\n".join(groups),
        FLAGS="\n".join(flags), VALUES="\n".join(values), POSITIONALS="\n".join(positionals),
    )  # fmt: skip


def zsh_script(commands: Sequence[Described]) -> str:
    """Write the completion of zsh."""
    groups = []
    for group, members in _groups(commands).items():
        shown = " ".join(
            _quoted(f"{member}:{_summary(commands, f'{group} {member}')}") for member in members
        )
        groups.append(
            f"    {group})\n      if (( CURRENT == 2 )); then\n        commands=({shown})\n"
            "        _describe -t commands command commands; return\n      fi\n"
            '      words[2]="$words[1] $words[2]"; shift words; (( CURRENT-- )) ;;'
        )
    arguments = []
    for command in commands:
        specs = [_quoted(spec) for option in command.options for spec in _zsh_specs(option)]
        arguments.append(
            f"    {_quoted(command.name)}) _arguments \\\n      "
            + " \\\n      ".join(specs)
            + " ;;"
        )
    top = [f"      {_quoted(f'{name}:{text}')}" for name, text in _top(commands).items()]
    return _filled(
        _ZSH, TOP="\n".join(top), GROUPS="\n".join(groups), ARGUMENTS="\n".join(arguments)
    )


def fish_script(commands: Sequence[Described]) -> str:
    """Write the completion of fish."""
    lines = []
    for name, text in _top(commands).items():
        lines.append(f"complete -c carosac -n __fish_use_subcommand -a {name} -d {_quoted(text)}")
    for flag in MAIN_OPTIONS:
        lines.append(f"complete -c carosac -n __fish_use_subcommand -l {flag.strip('-')}")
    for group, members in _groups(commands).items():
        alone = f"__carosac_command {group}; and not __fish_seen_subcommand_from"
        for member in members:
            text = _quoted(_summary(commands, f"{group} {member}"))
            condition = _quoted(f"{alone} {' '.join(members)}")
            lines.append(f"complete -c carosac -n {condition} -a {member} -d {text}")
    lines += [line for command in commands for line in _fish_lines(command)]
    return _filled(_FISH, LINES="\n".join(lines))


SCRIPTS: dict[str, Callable[[Sequence[Described]], str]] = {
    "bash": bash_script,
    "zsh": zsh_script,
    "fish": fish_script,
}


def _filled(template: str, **parts: str) -> str:
    """Put parts into a template."""
    for name, text in parts.items():
        template = template.replace(f"@{name}@", text)
    return template


def _top(commands: Sequence[Described]) -> dict[str, str]:
    """Return the first words of all commands with what they do."""
    groups = _groups(commands)
    return {
        name: _short(one.summary) if name not in groups else f"{name} {' or '.join(groups[name])}"
        for one in commands
        for name in [one.name.partition(" ")[0]]
    }


def _groups(commands: Sequence[Described]) -> dict[str, list[str]]:
    """Return the groups of commands of two words, with their members."""
    groups: dict[str, list[str]] = {}
    for one in commands:
        group, space, member = one.name.partition(" ")
        if space:
            groups.setdefault(group, []).append(member)
    return groups


def _summary(commands: Sequence[Described], name: str) -> str:
    """Return what a command does."""
    return next(_short(one.summary) for one in commands if one.name == name)


def _short(text: str) -> str:
    """Return the start of an explanation, without what a shell would take for its own."""
    first = text.split(". ")[0].split("; ")[0].rstrip(".").translate(_SHELL_CHARACTERS)
    if len(first) <= HELP_CHARACTERS_MAX:
        return first
    return first[: HELP_CHARACTERS_MAX - 3].rpartition(" ")[0] + " ..."


def _lines(names: Sequence[str]) -> str:
    r"""Join names by ``\n`` for a bash string in dollar quotes."""
    return "\\n".join(names)


def _quoted(text: str) -> str:
    """Quote a text that has no single quotes."""
    return f"'{text}'"


def _zsh_specs(option: Option) -> Iterator[str]:
    """Yield the specifications of ``_arguments``."""
    given = values_of(option)
    what = (option.metavar.partition(" ")[0] or option.field.upper()).replace(":", " ")
    action = _zsh_action(given)
    if not option.flags:
        yield f"{'*' if option.words == MANY_WORDS else '1'}:{what}:{action}"
        return
    for flag in option.flags:
        start = f"{flag}[{_short(option.help)}]"
        if option.words == 0:
            yield start
        elif option.words == MANY_WORDS:
            yield f"*{start}:*-*:{what}:{action}"
        else:
            yield f"*{start}" + f":{what}:{action}" * option.words


def _zsh_action(given: Values) -> str:
    """Return the action that completes values."""
    names = f"compadd -- {' '.join(given.names)}" if given.names else ""
    files = ""
    if given.files == (FOLDER,):
        files = "_files -/"
    elif given.files == (ANY_FILE,):
        files = "_files"
    elif given.files:
        files = f'_files -g "*.({"|".join(given.files)})"'
    parts = [part for part in (names, files) if part]
    return "{" + "; ".join(parts) + "}" if parts else " "


def _fish_lines(command: Described) -> Iterator[str]:
    """Yield the lines of one command."""
    condition = _quoted(f'__carosac_command "{command.name}"')
    for option in command.options:
        given = values_of(option)
        if not option.flags:
            yield f"complete -c carosac -n {condition}{_fish_values(given)}"
            continue
        text = _quoted(_short(option.help))
        for flag in option.flags:
            name = f"-s {flag[1:]}" if len(flag) == 2 else f"-l {flag[2:]}"
            any_file = given.files == (ANY_FILE,)
            takes = "" if not option.words else " -r" if any_file else " -x"
            values = _fish_values(given) if option.words else ""
            yield f"complete -c carosac -n {condition} {name}{takes}{values} -d {text}"
        if option.words == MANY_WORDS and given.names:
            after = _quoted(f'__carosac_takes "{command.name}" {" ".join(option.flags)}')
            yield f"complete -c carosac -n {after}{_fish_values(given)}"


def _fish_values(given: Values) -> str:
    """Return the part of a line that completes values."""
    if given.files == (ANY_FILE,):
        files, words = " -F", ""
    elif given.files == (FOLDER,):
        files, words = "", "(__fish_complete_directories)"
    else:
        files, words = "", f"(__carosac_files {' '.join(given.files)})" if given.files else ""
    names = " ".join([*given.names, *([words] if words else [])])
    return files + (f" -a {_quoted(names)}" if names else "")
