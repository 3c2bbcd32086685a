"""Case functions that workers can import: well-behaved ones and others."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.studies import Case, product

NAMES = {"robots": ["carosac"], "estimators": ["truth"], "sensors": ["lengths"],
         "trajectories": ["circle"], "perturbations": ["nominal-1"]}  # fmt: skip


def some_cases(count: int, controllers: tuple[str, ...] = ("good",), **settings: Any) -> list[Case]:
    return product(**NAMES, controllers=controllers, seeds=range(count), settings=settings)


def leave_a_file(case: Case, folder: Path) -> dict[str, Any]:
    """Write a file beside the rows."""
    (folder / f"{case.seed}.txt").write_text(f"seed {case.seed}")
    return {"length": case.seed}


def one_case(controller: str, seed: int = 0, **settings: Any) -> Case:
    return product(**NAMES, controllers=[controller], seeds=[seed], settings=settings)[0]


def score(case: Case) -> dict[str, Any]:
    """Draw some numbers; `settings` say how long that takes."""
    time.sleep(case.settings.get("duration", 0.0))
    rng = np.random.default_rng(case.rng_seed)
    state = rng.normal(size=(20, 20))
    return {
        "rmse_m": float(np.linalg.norm(state @ state.T)),
        "count": int(rng.integers(10)),
        "often_whole": 1 if case.seed % 3 else 0.5,
        "label": f"seed {case.seed}",
        "feasible": bool(case.seed % 2),
        "absent": None,
        "plant": np.float64(np.random.default_rng(case.plant_seed).normal()),
    }


def log_and_score(case: Case) -> dict[str, Any]:
    """Leave a trace of each run."""
    with Path(case.settings["log"]).open("a") as log:
        log.write(f"{case.identity} {os.getpid()}\n")
    return score(case)


def behave(case: Case) -> dict[str, Any]:
    """Do what the controller's name says."""
    return {"good": score, **BEHAVIOURS}[case.controller](case)


def _raise(case: Case) -> dict[str, Any]:
    raise ValueError("no such pose")


def _die(case: Case) -> dict[str, Any]:
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


def _fault(case: Case) -> dict[str, Any]:
    return {"never": ctypes.string_at(0)}


def _loop(case: Case) -> dict[str, Any]:
    """Run Python for ever, deaf to ordinary exceptions."""
    while True:
        with contextlib.suppress(Exception):
            time.sleep(0.001)


def _hang(case: Case) -> dict[str, Any]:
    """Wait in compiled code for ever."""
    time.sleep(1e6)
    return {}


def _seize(case: Case) -> dict[str, Any]:
    """Wait in compiled code that lets no other thread run."""
    ctypes.PyDLL(None).sleep(1000)
    return {}


def _once(case: Case) -> dict[str, Any]:
    """Die at the first attempt only."""
    marker = Path(case.settings["folder"]) / "was here"
    if not marker.exists():
        marker.touch()
        _die(case)
    return score(case)


def _again_and_again(case: Case) -> dict[str, Any]:
    """Die at each attempt, for as long as `settings` say."""
    marker = Path(case.settings["folder"]) / "first attempt"
    if not marker.exists():
        marker.touch()
    if time.time() - marker.stat().st_mtime < case.settings["dying"]:
        _die(case)
    return score(case)


def _nan(case: Case) -> dict[str, Any]:
    return {"rmse_m": float("nan")}


def _list(case: Case) -> Any:
    return [1.0]


def _clash(case: Case) -> dict[str, Any]:
    return {"seed": 1}


def _leave(case: Case) -> dict[str, Any]:
    raise SystemExit(3)


BEHAVIOURS = {
    "raises": _raise, "dies": _die, "faults": _fault, "loops": _loop, "hangs": _hang,
    "seizes": _seize, "dies once": _once, "nan": _nan, "list": _list, "clash": _clash,
    "leaves": _leave, "dies again and again": _again_and_again,
}  # fmt: skip


def without_times(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows without what no two runs share."""
    return [{name: x for name, x in row.items() if name != "wall_time_s"} for row in rows]


def group(case: Case) -> str | None:
    """All but those of `single` may run together."""
    return None if case.controller == "single" else case.controller


def together(cases: list[Case]) -> list[dict[str, Any]]:
    """Several at once, marked as such; do what the controller's name says."""
    if cases[0].controller == "raises":
        raise ValueError("one of them has no such pose")
    if cases[0].controller == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    return [score(case) | {"label": f"one of {len(cases)}"} for case in cases]


def diverge(case: Case) -> dict[str, Any]:
    """Diverge on odd seeds."""
    return {"error": 1.0, "diverged": "the platform left" if case.seed % 2 else None}
