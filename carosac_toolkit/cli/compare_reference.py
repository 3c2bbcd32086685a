"""``carosac compare --suite``: the reference suite, all of it or with an entry of the user."""

from __future__ import annotations

import re
import shlex
import time
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.files import write_json
from carosac_toolkit.base.tables import counted, terminal_width, wrapped
from carosac_toolkit.cli.common import CommandResult
from carosac_toolkit.cli.compare_options import Options
from carosac_toolkit.loop.plugin_settings import chosen_settings
from carosac_toolkit.reports.page import check_folder, made_with, write_files
from carosac_toolkit.reports.study import write_report
from carosac_toolkit.studies.compare.findings import conclusions
from carosac_toolkit.studies.compare.paper_tables import text_errors, text_tables
from carosac_toolkit.studies.compare.surprises import surprises
from carosac_toolkit.studies.compare.tables import failures
from carosac_toolkit.studies.reference.cases import ReferenceSuite, SuiteTask
from carosac_toolkit.studies.reference.check import SuiteAgreement, agreement
from carosac_toolkit.studies.reference.results import (
    RECORD,
    RESULTS,
    TABLES,
    PartResults,
    check_same,
    read_rows,
    record,
    tables,
    with_published,
    write_rows,
)
from carosac_toolkit.studies.run.rows import Row

ADJUSTABLE_OPTIONS = (
    "suite", "controllers", "estimators", "settings", "against", "quick", "scheduler", "workers",
    "timeout", "retry", "output", "json",
)  # fmt: skip
DEFAULT_PARENT_FOLDER = Path("carosac-results")


def run_suite(options: Options, name: str) -> CommandResult:
    """Run a suite, or the part that an entry needs; print and write the results."""
    _check_fixed(options)
    suite = ReferenceSuite.load(name)
    suite = suite.quick() if options.quick else suite
    published: list[Row] | None = None
    if options.against is not None:
        check_same(suite, Path(options.against))
        published = read_rows(Path(options.against))
    tasks = _tasks(options, suite)
    for task in tasks:
        task.study.check()
    folder = options.output or _folder(options, suite)
    check_folder("--output", folder)
    print(wrapped(_what(suite, tasks), terminal_width()), flush=True)
    started = time.monotonic()
    parts = [_run(task, folder, options, suite) for task in tasks]
    return _finish(options, suite, parts, published, folder, time.monotonic() - started)


def _check_fixed(options: Options) -> None:
    """Refuse options that the suite fixes."""
    for field in fields(options):
        if field.name not in ADJUSTABLE_OPTIONS and getattr(options, field.name) != field.default:
            value = repr(getattr(options, field.name))
            raise InvalidField(f"--{field.name}", value, "nothing with --suite, which fixes it")


def _tasks(options: Options, suite: ReferenceSuite) -> list[SuiteTask]:
    """Return the studies to run."""
    known = suite.definition["parts"].values()
    names = {
        axis: [*getattr(options, axis), *(name for part in known for name in part[axis])]
        for axis in ("controllers", "estimators")
    }
    chosen = chosen_settings(options.settings, **names)
    if chosen.pop("driver_settings"):
        raise InvalidField("--set", "a setting of the driver", "none with --suite, which fixes it")
    execution = {x: getattr(options, x) for x in ("scheduler", "workers", "timeout", "retry")}
    return suite.tasks(options.controllers, options.estimators, **execution, **chosen)


def _folder(options: Options, suite: ReferenceSuite) -> Path:
    """Return the default results folder; entries are kept apart from the whole suite."""
    entries = (*options.controllers, *options.estimators, *options.settings)
    words = [re.sub(r"[^\w.=-]+", "_", name) for name in entries]
    return DEFAULT_PARENT_FOLDER / "-".join([suite.name, *words])


def _what(suite: ReferenceSuite, tasks: Sequence[SuiteTask]) -> str:
    """Describe the suite that is about to run."""
    cases = sum(len(task.study.cases()) for task in tasks)
    return (
        f"Suite {suite.name}, definition {suite.digest}: {counted(cases, 'case')} in "
        f"{counted(len(tasks), 'study', 'studies')} "
        f"({', '.join(f'{task.part} on {task.robot}' for task in tasks)})"
    )


def _run(task: SuiteTask, folder: Path, options: Options, suite: ReferenceSuite) -> PartResults:
    """Run one study and print its table."""
    width = terminal_width()
    place = folder / task.part / task.robot
    print(f"\n{task.part.capitalize()} on {task.robot}", flush=True)
    results = replace(task.study, output=place).run()
    part = PartResults(task=task, results=results)
    write_report(results, conclusions(results), _words(options, suite), part.blocks)
    print(f"\n{text_errors(part.blocks, width)}\n")
    for line in surprises(results):
        print(wrapped(line, width, "! "))
    for line in failures(results):
        indent = " " * (len(line) - len(line.lstrip()))
        print(wrapped(line.lstrip(), width, indent))
    return part


def _finish(
    options: Options,
    suite: ReferenceSuite,
    parts: list[PartResults],
    published: Sequence[Row] | None,
    folder: Path,
    took: float,
) -> CommandResult:
    """Print the paired comparisons, and write the files of the whole suite."""
    width, command = terminal_width(), shlex.join(_words(options, suite))
    shown = parts
    if published is not None:
        shown = [with_published(part, published) for part in parts]
        for line in _notes(agreement([row for part in parts for row in part.rows], published)):
            print(wrapped(line, width, "* "))
    provenance = made_with() | {"time": f"{took / 60:.1f} minutes, earlier results excluded"}
    for part in shown:
        print(f"\n{text_tables(part.blocks, width, before=f'{part.task.part.capitalize()}. ')}")
    data: dict[str, Any] = record(suite, shown, provenance, command) | {"minutes": took / 60}
    origin = "\n".join([f"    {name}: {text}" for name, text in
                        {"command": command, **provenance}.items() if text])  # fmt: skip
    texts = {RESULTS: write_rows(parts), TABLES: tables(suite, shown, origin)}
    write_files(folder, {name: text.encode() for name, text in texts.items()})
    write_json(folder / RECORD, data)
    data["output"] = str(folder)
    print(f"\nresults: {folder}, with {TABLES}, {RESULTS} (one row per case) and {RECORD};")
    print("below it, a report of each study")
    return CommandResult(data, status=0 if all(part.results.complete for part in parts) else 1)


def _notes(comparison: SuiteAgreement) -> list[str]:
    """Tell whether these results agree with the published ones, before comparing the rest."""
    if not comparison.differences:
        return ["No published case ran here, so that the agreement is unknown."]
    if comparison.faults:
        return ["The numbers of this machine differ from the published ones:", *comparison.faults]
    return [
        "The cases that ran here agree with the published ones within "
        f"{100 * comparison.largest:.2f} %."
    ]


def _words(options: Options, suite: ReferenceSuite) -> list[str]:
    """Return the command line that repeats this run."""
    words = ["carosac", "compare", "--suite", suite.name.removesuffix("-quick")]
    words += ["--quick"] if options.quick else []
    for name in ("controllers", "estimators"):
        names = getattr(options, name)
        words += [f"--{name}", *names] if names else []
    words += ["--against", options.against] if options.against is not None else []
    return words + [word for text in options.settings for word in ("--set", text)]
