"""Comparative studies: many cases, each a loop with a seed, run on all cores and kept on disk."""

from carosac_toolkit.studies.run.case import Case, product
from carosac_toolkit.studies.run.engine import run_cases
from carosac_toolkit.studies.run.execution import UnfitWorker
from carosac_toolkit.studies.run.folder import StudyConflict, read_cases, read_rows
from carosac_toolkit.studies.run.rows import Row
from carosac_toolkit.studies.run.worker_presence import LostScheduler

__all__ = [
    "Case",
    "LostScheduler",
    "Row",
    "StudyConflict",
    "UnfitWorker",
    "product",
    "read_cases",
    "read_rows",
    "run_cases",
]
