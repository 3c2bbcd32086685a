"""Figures of the paper that are drawn from trainings and evaluations."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from carosac_toolkit.pictures.paper_figure import Drawn, FigureSource, PaperFigure, of_kind
from learned.pictures.evaluation import draw_histograms, draw_paths, draw_violins
from learned.pictures.reward_figure import paper_reward_terms
from learned.pictures.training import LearningCurve, curve_of, learning_curves
from learned.saved_scores import SavedScores
from learned.scores import sound_paths

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POLICY_SCORES = "policy"
TRAIN_COMMAND = "carosac train --preset paper --output DIR"
NO_SAG_COMMAND = "carosac evaluate POLICY --protocol no-sag --output DIR"
SETTLE_COMMAND = "carosac evaluate POLICY --protocol settle --output DIR"


def _made(draw: Callable[[Path], Figure]) -> Figure:
    """Return the figure of a function that also writes it somewhere."""
    with tempfile.TemporaryDirectory() as folder:
        return draw(Path(folder) / "figure.svg")


def _evaluated(
    draw: Callable[[SavedScores, Path], Figure], protocols: Sequence[str]
) -> Callable[[Sequence[FigureSource]], list[Drawn]]:
    """Return the figure of an evaluation: the first of these protocols that exists."""

    def drawn(sources: Sequence[FigureSource]) -> list[Drawn]:
        there = {folder: SavedScores.read(folder) for folder in of_kind(sources, "evaluation")}
        sound = {
            k: saved for k, saved in there.items() if sound_paths(saved.scores[POLICY_SCORES]).any()
        }
        for protocol in protocols:
            for folder, saved in sound.items():
                if saved.protocol == protocol:
                    figure = _made(lambda path, saved=saved: draw(saved, path))  # type: ignore[misc]
                    return [Drawn(figure=figure, source=folder)]
        return []

    return drawn


def _trained(sources: Sequence[FigureSource]) -> list[Drawn]:
    """Return one figure for each stage, with the curves of all its trainings."""
    stages: dict[str, dict[Path, LearningCurve]] = {}
    folders = of_kind(sources, "training")
    for folder in folders:
        name = folder.parent.name
        if any(other.parts[-2:] == folder.parts[-2:] for other in folders if other != folder):
            name = f"{folder.parent.parent.name}/{name}"  # a seed of one of several variations
        curve = curve_of(folder, name)
        if curve is not None:
            stages.setdefault(folder.name, {})[folder] = curve
    return [
        Drawn(
            figure=_made(lambda path, curves=curves: learning_curves(list(curves.values()), path)),  # type: ignore[misc]
            source=next(iter(curves)), more=stage,
        )
        for stage, curves in stages.items()
    ]  # fmt: skip


def _rewards(sources: Sequence[FigureSource]) -> list[Drawn]:
    """Return the figure of the reward functions: it needs no data, but belongs to trainings.

    It is drawn beside them, and where no folder is named at all.
    """
    trainings = of_kind(sources, "training")
    return [Drawn(figure=_made(paper_reward_terms))] if trainings or not sources else []


FIGURES = (
    PaperFigure(
        place=5, name="reward", command=TRAIN_COMMAND, draw=_trained,
        what="reward of each episode, raw and smoothed, of each stage",
    ),
    PaperFigure(
        place=6, name="reward_terms", command=TRAIN_COMMAND, draw=_rewards,
        what="terms of the reward against their variables",
    ),
    PaperFigure(
        place=7, name="error_histograms", command=NO_SAG_COMMAND,
        draw=_evaluated(
            lambda saved, path: draw_histograms(saved.scores[POLICY_SCORES], saved.robot, path),
            ("no-sag", "settle", "realtime"),
        ),
        what="mean position and length error over trajectories",
    ),
    PaperFigure(
        place=8, name="sample_paths", command=NO_SAG_COMMAND,
        draw=_evaluated(
            lambda saved, path: draw_paths(saved.scores[POLICY_SCORES], saved.robot, path),
            ("no-sag", "settle", "realtime"),
        ),
        what="sample paths in space",
    ),
    PaperFigure(
        place=9, name="trajectory_violins", command=SETTLE_COMMAND,
        draw=_evaluated(
            lambda saved, path: draw_violins(saved.scores[POLICY_SCORES], saved.robot, path),
            ("settle", "realtime", "no-sag"),
        ),
        what="error per axis over trajectories",
    ),
)  # fmt: skip
