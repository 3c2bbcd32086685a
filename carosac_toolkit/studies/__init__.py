"""Comparative studies: many cases, each a loop with a seed, run on all cores and kept on disk."""

from carosac_toolkit.studies.case import Case, product
from carosac_toolkit.studies.engine import run_cases
from carosac_toolkit.studies.execution import UnfitWorker
from carosac_toolkit.studies.folder import StudyConflict, read_cases, read_rows
from carosac_toolkit.studies.presence import LostScheduler
from carosac_toolkit.studies.rows import Row

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
