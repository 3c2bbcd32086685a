"""Report of a validation: a folder of pictures, and one self-contained report.html."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from carosac_toolkit.recordings.metadata import RecordingMetadata
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
from carosac_toolkit.validation.phases import REST_DURATION_MIN_S, REST_SPEED_MAX_M_S
from carosac_toolkit.validation.result import ValidationResult
from carosac_toolkit.validation.saved import SAMPLES_FILE, samples_bytes
from carosac_toolkit.validation.tables import (
    CAUSE_HEADER,
    EFFECT_HEADER,
    PART_HEADER,
    cause_rows,
    effect_rows,
    part_rows,
    part_units,
)

EFFECTS_TEXT = (
    "<p>Shares of the mean squared error, turns taken at the lever arm of the platform. The error "
    "is regressed on what each effect does to the simulation. A share is what the effect explains "
    "of stretches that the regression did not see, beyond the effects that explain more. Effects "
    "resemble each other, such as tilt, centre of mass and length offsets: what several of them "
    "could explain counts for the one that explains most. Only what an effect adds to all others "
    "speaks for it as a cause.</p>"
)
SETTINGS_FILE = "report_settings.json"
VALIDATION_CAPTIONS = {
    "paths": "Path of the platform origin: measured and modelled, with the errors enlarged.",
    "error_violins": "Distribution of the position error, model minus measured, per axis and in "
    "norm.",
    "time_series": "Position and error over time; grey: the winches rest.",
    "length_errors": "Measured cable lengths less those that each model predicts at the measured "
    "pose: straight cables for a model without tensions, hanging and stretched ones otherwise.",
}


@dataclass(frozen=True, kw_only=True)
class Context:
    """Origin of a result.

    Attributes:
        recording: Name or path of the recording, as it was given.
        metadata: Metadata of the recording.
        words: The command that repeats the validation.
        file: The recording's file.
        guess: Reason for the guessed robot, or empty.
    """

    recording: str
    metadata: RecordingMetadata
    words: list[str]
    file: Path
    guess: str = ""

    @property
    def settings(self) -> dict[str, object]:
        """Return the settings that identify a report, written beside it."""
        return {"file": str(self.file.resolve()), "command": shlex.join(self.words)}


def free_folder(base: Path, context: Context) -> Path:
    """Choose a folder that holds no report of anything else: `base`, `base`-2, `base`-3, ...

    Args:
        base: The first choice.
        context: A folder with a report of the same is free: that report is replaced.
    """
    for number in count(1):
        folder = base if number == 1 else base.with_name(f"{base.name}-{number}")
        if not folder.exists() or _settings(folder) == context.settings:
            return folder
    raise AssertionError("count() ends nowhere")


def _settings(folder: Path) -> object:
    """Return the settings of the report in a folder, or None."""
    try:
        return json.loads((folder / SETTINGS_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def write_report(
    folder: Path, result: ValidationResult, said: list[str], context: Context
) -> list[Path]:
    """Draw the pictures and write the report; every file appears whole, or nothing does.

    Args:
        folder: Made if need be; files of an earlier report in it are replaced.
        result: Result of the validation.
        said: Conclusions, as sentences.
        context: Origin of the result.

    Returns:
        The files, the report last.
    """
    from carosac_toolkit.pictures.saving import picture_files
    from carosac_toolkit.pictures.validation import VALIDATION_PICTURES

    drawn = VALIDATION_PICTURES.items() if _any_scored(result) else ()
    images = picture_files({name: draw(result) for name, draw in drawn})
    settings = json.dumps(context.settings, indent=2, ensure_ascii=False) + "\n"
    document = _html(result, said, context, images)
    files = {SETTINGS_FILE: settings.encode()}
    if images:
        files[SAMPLES_FILE] = samples_bytes(result)
    return write_files(folder, {**images, **files, "report.html": document.encode()})


def _any_scored(result: ValidationResult) -> bool:
    return any(model.scores is not None for model in result.models.values())


def _html(
    result: ValidationResult, sentences: list[str], context: Context, images: dict[str, bytes]
) -> str:
    """Return the whole document."""
    name = f"Validation of {', '.join(result.models)} on {Path(context.recording).name}"
    parts = [
        *warnings(result.warnings),
        bullets(sentences),
        f"<h2>Errors</h2><p>{part_units(result)}. Error is model minus measured, in world frame W. "
        f"Winches rest where no cable length changes faster than {REST_SPEED_MAX_M_S * 1e3:g} mm/s "
        f"for at least {REST_DURATION_MIN_S:g} s; the platform may still sway.</p>",
        table(PART_HEADER, part_rows(result), left=2),
        "<h2>What may explain them</h2><p>Delay: least squares of the error with moving winches "
        "on the measured velocity; positive means that poses are late against the lengths. Sway: "
        "the frequency that fits the error with resting winches best, on the axis that swings "
        "most.</p>",
        table(CAUSE_HEADER, cause_rows(result), left=1),
        *_effects(result),
        *pictures(images, VALIDATION_CAPTIONS),
        "<h2>Provenance</h2>",
        definitions({**_provenance(result, context), **made_with()}),
        repeat(context.words),
    ]
    return page(name, parts)


def _effects(result: ValidationResult) -> list[str]:
    """Return the section on the effects that the error looks like, where they are known."""
    if result.effects is None:
        return []
    return [
        f"<h2>What the error of {result.effects_model} looks like</h2>{EFFECTS_TEXT}",
        table(EFFECT_HEADER, effect_rows(result.effects), left=1),
    ]


def _provenance(result: ValidationResult, context: Context) -> dict[str, str]:
    """Return the inputs of the validation."""
    metadata, robot = context.metadata, result.robot
    return {
        "recording": context.recording,
        "description": metadata.description,
        "source": metadata.source,
        "licence": metadata.licence,
        "cite": metadata.citation,
        "written by": metadata.created_by,
        "samples scored": f"{result.samples} of {result.start}:{result.stop}, "
        f"{len(result.rests)} rests of the winches",
        "robot": f"{robot.name}: {robot.description}",
        "robot chosen by": context.guess,
        "robot licence": robot.licence,
        "seed": str(result.seed),
        "models": ", ".join(result.models) + "; each with its default settings",
    }
