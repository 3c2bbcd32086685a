"""Report of a study: table, failures, pictures and settings, in its folder."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from carosac_toolkit.base.errors import InvalidField, did_you_mean
from carosac_toolkit.reports.page import (
    bullets,
    definitions,
    made_with,
    page,
    pictures,
    repeat,
    table,
    warnings,
    write_files,
)
from carosac_toolkit.studies.compare.example_cases import curves_of
from carosac_toolkit.studies.compare.feasibility import infeasible
from carosac_toolkit.studies.compare.names import short_name
from carosac_toolkit.studies.compare.paired import PairedBlock, paired_blocks
from carosac_toolkit.studies.compare.paper_tables import explanation, latex, markdown, sheets
from carosac_toolkit.studies.compare.results import COLUMN_TITLES, StudyResults, estimated, tracked
from carosac_toolkit.studies.compare.surprises import surprises
from carosac_toolkit.studies.compare.tables import failures, header, name_columns, rows, units
from carosac_toolkit.studies.compare.terminal_table import caption, terminal_table
from carosac_toolkit.studies.run.robot_copies import PATHS_FOLDER, copy_of

REPORT_COLUMNS = 200  # characters of the summary table, which scrolls where it is wider
TABLES_MARKDOWN, TABLES_LATEX, STATISTICS = "tables.md", "tables.tex", "statistics.json"
ANIMATION_FILE = "animation.webp"
ANIMATED_MAX = 3  # controllers side by side
STUDY_CAPTIONS = {
    "animation": "The same case under some controllers: cables by tension, distance of the "
    "platform from its reference.",
    "paired": "Every error over that of the baseline on the same draws, with its 95 % interval: "
    "left of 1 is better. Full marks: the Holm-corrected p is at most 0.05; open ones: it is "
    "above, so the difference may be chance; on the right: cases in which the error was smaller.",
    "paths": "One case: path of the platform origin and its reference, errors enlarged.",
    "error_over_time": "One case: tracking error per axis; grey: the reference rests; a cross: "
    "where a case that diverged leaves the panel, or ends.",
    "error_violins": "Distribution of the tracking error over the samples of all trajectories, "
    "first seed.",
    "rmse_distribution": "How much the RMSE differs from case to case, over all trajectories and "
    "seeds: share of cases with at most this RMSE. A curve that ends below 1 has cases without a "
    "score.",
    "regions": "Tracking error in the centre (the middle half of each side) and near the boundary "
    "of the workspace box, over all cases.",
    "estimation": "Distribution of the estimation error over the samples of all trajectories, "
    "first seed, by estimator; where it has a covariance, also whether its errors are as large as "
    "it says.",
}


def write_report(
    results: StudyResults,
    said: Sequence[str],
    words: Sequence[str],
    blocks: Sequence[PairedBlock] | None = None,
    animation: bytes | None = None,
) -> list[Path]:
    """Draw the pictures and write tables and ``report.html`` into the folder of the study.

    Args:
        results: Results of the study.
        said: Conclusions, as sentences.
        words: The command that repeats it.
        blocks: Its paired comparisons; by default those with the first of each block.
        animation: Animated WebP to show first, or None.

    Returns:
        The files, the report last.
    """
    blocks = paired_blocks(results) if blocks is None else blocks
    images = _images(results, blocks)
    if animation is not None:
        images = {ANIMATION_FILE: animation, **images}
    document = _html(results, said, words, images, blocks)
    origin = _origin(results, words)
    tables = {
        TABLES_MARKDOWN: markdown(blocks, f"```text\n{origin}\n```"),
        TABLES_LATEX: latex(blocks, origin),
        STATISTICS: json.dumps([block.data() for block in blocks], indent=1) + "\n",
    }
    files = {name: text.encode() for name, text in tables.items()}
    return write_files(results.folder, {**images, **files, "report.html": document.encode()})


def check_animation(controllers: Sequence[str], known: Sequence[str]) -> None:
    """Refuse an animation that could not be drawn, before a study runs.

    Raises:
        InvalidField: Too many controllers, or one that the study does not have.
    """
    if len(set(controllers)) < len(controllers) or len(controllers) > ANIMATED_MAX:
        allowed = f"one to {ANIMATED_MAX} different controllers of the study"
        raise InvalidField("--animation", repr(list(controllers)), allowed)
    for name in controllers:
        if name not in known:
            allowed = f"of the study: {list(known)}{did_you_mean(name, known)}"
            raise InvalidField("--animation", repr(name), allowed)


def animation_of(results: StudyResults, controllers: Sequence[str]) -> bytes:
    """Draw the animation of some controllers, in the case whose time series was kept.

    Raises:
        CarosacError: A controller has no such case.
    """
    from carosac_toolkit.pictures.animation import animation_webp
    from carosac_toolkit.pictures.motions import motions_of

    return animation_webp(motions_of(results.folder, results.rows, controllers))


def _images(results: StudyResults, blocks: Sequence[PairedBlock]) -> dict[str, bytes]:
    """Draw the pictures for which there are data, as files in all formats."""
    from carosac_toolkit.pictures.comparison import COMPARISON_PICTURES, in_both_regions
    from carosac_toolkit.pictures.paired import comparable, draw_paired
    from carosac_toolkit.pictures.saving import picture_files

    names = list(COMPARISON_PICTURES) if tracked(results.rows) else []
    if all(len(tracked(rows)) < 2 for rows in results.groups):  # one case does not scatter
        names = [name for name in names if name != "rmse_distribution"]
    if not in_both_regions(results):  # one column compares nothing
        names = [name for name in names if name != "regions"]
    if not names and curves_of(results.rows):  # all cases diverged
        names = ["paths", "error_over_time"]
    if not names and estimated(results.rows):  # nothing follows commands on a recording
        names = ["estimation"]
    figures = {name: COMPARISON_PICTURES[name](results) for name in names}
    if comparable(blocks):
        figures = {"paired": draw_paired(blocks), **figures}
    return picture_files(figures)


def _origin(results: StudyResults, words: Sequence[str]) -> str:
    """Return how the numbers were made, in lines of text."""
    digests = dict.fromkeys(
        f"robot {row['robot']}: sha256 {digest}"
        for row in results.rows
        if (digest := json.loads(str(row["settings"])).get("robot_digest"))
    )
    terms = [f"{name}: {text}" for name, text in made_with().items() if text]
    return "\n".join([f"command: {shlex.join(words)}", *digests, *terms])


def _html(
    results: StudyResults,
    sentences: Sequence[str],
    words: Sequence[str],
    images: Mapping[str, bytes],
    blocks: Sequence[PairedBlock],
) -> str:
    """Return the whole document."""
    names = list(dict.fromkeys(str(row["controller"]) for row in results.rows))
    failed = "\n".join(failures(results))
    parts = [
        *warnings(one.sentence() for one in infeasible(results.feasibility)),
        *warnings(surprises(results)),
        f"<p>{escape(caption(results, REPORT_COLUMNS))}</p>",
        f"<pre>{escape(terminal_table(results, REPORT_COLUMNS))}</pre>",
        bullets(sentences),
        f"<h2>Errors</h2><p>{escape(units(results))}</p>",
        table(header(results), rows(results), left=name_columns(results)),
        f"<h2>Paired comparison</h2><p>{escape(explanation(blocks))}</p>",
        *(
            f"<h3>{escape(sheet.title)}</h3>"
            + table(sheet.header, list(sheet.rows), left=sheet.left, bold=sheet.bold)
            for sheet in sheets(blocks)
        ),
        f"<p>The same as {TABLES_MARKDOWN} and {TABLES_LATEX}, and all digits in {STATISTICS}, "
        "beside this page.</p>",
        f"<h2>Cases without a score</h2><pre>{escape(failed)}</pre>" if failed else "",
        *pictures(images, STUDY_CAPTIONS),
        "<h2>Settings</h2>",
        definitions({**_settings(results), **made_with()}),
        repeat(words),
    ]
    return page(f"Comparison of {', '.join(map(short_name, names))}", parts)


def _settings(results: StudyResults) -> dict[str, str]:
    """Return the settings of the cases."""
    terms = {"cases": str(len(results.rows))}
    for name in (
        "robot",
        "controller",
        "estimator",
        "sensors",
        "trajectory",
        "perturbation",
        "seed",
    ):
        values = dict.fromkeys(str(row[name]) for row in results.rows)
        terms[COLUMN_TITLES.get(name, name)] = ", ".join(values)
    shared: dict[str, dict[str, None]] = {}
    for row in results.rows:
        for name, value in json.loads(str(row["settings"])).items():
            shared.setdefault(name, {})[json.dumps(value).strip('"')] = None
    terms |= {name: "; ".join(values) for name, values in shared.items()}
    copies = dict.fromkeys(
        f"{row['robot']}: {path.relative_to(results.folder)}"
        for row in results.rows
        if (path := copy_of(results.folder, row)) is not None
    )
    terms["robot files"] = "; ".join(copies)
    paths = sorted((results.folder / PATHS_FOLDER).glob("*"))
    if paths:
        terms["trajectory files"] = "; ".join(str(x.relative_to(results.folder)) for x in paths)
    return terms | {"results": f"Parquet files beside this page, in {results.folder.resolve()}"}
