"""Every ``carosac`` command in README and docs is understood; those of three pages run.

``make docs-commands`` runs all of them.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from carosac_toolkit.cli.arguments import parse_options
from carosac_toolkit.cli.main import main
from carosac_toolkit.loop.plugins import load

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs"))
import commands  # noqa: E402

ALL = commands.written()
PAGES = ("interchange", "tutorial-robot")  # whose programs run too


def command_of(words):
    """Name of the command with its group, and the words after it."""
    group = words[0] in ("calibrate", "import")
    return (".".join(words[:2]), words[2:]) if group else (words[0], words[1:])


def test_there_are_commands_and_exceptions_are_still_written():
    assert len(ALL) > 50
    named = {*commands.EXCEPTIONS, *commands.NEGATIVE, *commands.UNCERTAIN}
    assert named <= {command.text for command in ALL}


def test_every_command_is_run_by_one_job_and_what_belongs_together_stays_so():
    todo = commands.to_run()
    parts = commands.shares(todo, 3)
    assert sorted(c.text for part in parts for c in part) == sorted(c.text for c in todo)
    pages = [{c.page for c in part} for part in parts]
    assert sum(map(len, pages)) == len(set.union(*pages))
    assert sum(any(c.name in ("plc", "run") for c in part) for part in parts) == 1


MADE = {f"carosac {words}" for words, _ in commands.MADE}


@pytest.mark.parametrize("text", sorted({c.text for c in ALL if not c.synopsis} | MADE))
def test_commands_are_understood(text):
    words = commands.Written("", text).words
    name, rest = command_of(words)
    for line in (rest, command_of(commands.shortened(words))[1]):
        parse_options(load("commands", name), name, line)


@pytest.mark.parametrize(
    "command", [c for c in ALL if c.synopsis], ids=lambda c: " ".join(c.words[:2])
)  # fmt: skip
def test_synopses_name_options_that_there_are(command, capsys):
    name, _ = command_of(command.words)
    with pytest.raises(SystemExit):
        parse_options(load("commands", name), name, ["--help"])
    known = set(re.findall(r"--[a-z][a-z-]+", capsys.readouterr().out))
    assert set(re.findall(r"--[a-z][a-z-]+", command.text)) <= known


def test_quick_commands_of_three_pages_run(tmp_path, monkeypatch, quick_pictures):
    monkeypatch.chdir(tmp_path)
    commands.bring(tmp_path)
    pages = [f"{page}.md" for page in (*PAGES, "calibration-lengths")]
    quick = [c for c in commands.to_run(commands.QUICK) if c.page in pages]
    assert {c.page for c in quick} == set(pages)
    assert commands.run_all(main, quick) == []
    for page in PAGES:
        for program in commands.programs(page):
            exec(program, {})  # works on what the commands of the page have made
