from __future__ import annotations

import numpy as np
import pytest

import carosac_toolkit as ct
from calibration.estimate import ParameterEstimate
from calibration.observability import judge
from calibration.pictures import draw_exit_points, draw_learnt, draw_residuals
from calibration.report import (
    PARAMETER_HEADER,
    ReportContent,
    blunders_html,
    observability_html,
    parameter_rows,
    parameters_html,
    print_parameters,
    print_sentences,
    write_report,
)
from calibration.result import CalibrationResult

ESTIMATE = ParameterEstimate(
    names=("exit_points[a].x", "length_delay", "pose_tilt.x", "mass", "length_scale[a]", "drag"),
    value=[1.50123, 0.0331, 1e-3, 23.7, 1.0021, 0.3],
    covariance=np.diag(np.square([1.5e-4, 2e-4, 1e-4, 12.0, 3e-5, 0.0]) + 0.0),
    start=[1.49, 0.0, 0.0, 20.0, 1.0, 0.3],
    prior_sigma=[0.05, 0.1, np.inf, 5.0, 1e-3, 0.1],
)


class Finished(CalibrationResult):
    """A result of nothing but what all results have."""

    def sentences(self):
        return ["all is well"]

    def data(self):
        return {"parameters": self.estimate.data()}


def test_numbers_have_two_digits_of_their_sigma_in_units_people_use():
    rows = {
        row[0]: dict(zip(PARAMETER_HEADER, row, strict=True)) for row in parameter_rows(ESTIMATE)
    }
    point = rows["exit_points[a].x"]
    assert [point[key] for key in ("unit", "before", "known to", "after", "1 sigma")] == [
        "mm", "1490.00", "50", "1501.23", "0.15",
    ]  # fmt: skip
    assert point["moved by"] == "+11.23" and point["in sigmas before"] == "0.2"
    assert rows["length_delay"]["after"] == "33.10" and rows["length_delay"]["unit"] == "ms"
    assert rows["pose_tilt.x"]["known to"] == "nothing"
    assert rows["pose_tilt.x"]["in sigmas before"] == "-"
    assert rows["mass"]["after"] == "24" and rows["mass"]["unit"] == "kg"
    assert rows["length_scale[a]"]["after"] == "1.002100" and rows["length_scale[a]"]["unit"] == "1"
    assert rows["drag"]["1 sigma"] == "0" and rows["drag"]["after"] == "0.300000"  # exact


def test_the_table_keeps_to_the_width_of_the_terminal(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    print_parameters(ESTIMATE)
    print_sentences(["word " * 40])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[-2].startswith("  word") and any(line.startswith("* word") for line in lines)


def test_a_report_holds_tables_sentences_pictures_and_the_command(tmp_path):
    observability = judge(("mass", "drag"), np.diag([1.0, 0.0]), np.ones(2))
    learnt = (draw_learnt("carosac", ESTIMATE), "exit points")
    parts = [
        parameters_html(ESTIMATE),
        observability_html(observability),
        blunders_html(("shot",), [("a<b",)], left=1),
    ]
    result = Finished(
        before=ct.load_robot("carosac"), estimate=ESTIMATE, observability=observability,
        warnings=("but look",),
    )  # fmt: skip
    files = write_report(
        tmp_path / "report",
        "Calibration of <robot>",
        result,
        ReportContent(parts=parts, images={"points": learnt}),
        provenance={"recording": "run.csv"},
        command=["carosac", "calibrate", "lengths", "run.csv"],
    )
    assert [path.name for path in files] == [
        "points.png", "points.svg", "points.pdf", "report.html"
    ]  # fmt: skip
    text = files[-1].read_text(encoding="utf-8")
    assert "data:image/png;base64," in text and 'href="points.pdf"' in text
    for part in (
        "Calibration of &lt;robot&gt;", "exit_points[a].x", "1501.23", "a&lt;b", "all is well",
        "but look", "the data say nothing about drag", "carosac calibrate lengths run.csv",
    ):  # fmt: skip
        assert part in text
    assert "<p>None.</p>" in blunders_html(("shot",), [], left=1)


def panels(before, after, posterior, prior=None):
    """Axes of one exit point."""
    known = None if prior is None else prior[None]
    figure = draw_exit_points("r", ["a"], before[None], known, after[None], posterior[None])
    return figure.axes


@pytest.mark.parametrize("moved", [0.0, 1e-3, 0.02, 0.5])
def test_the_ellipse_after_the_calibration_fills_a_good_part_of_its_panel(moved):
    """Whatever was known before, half a metre or nothing, and however far the point moved."""
    posterior = np.diag([1e-3, 2e-3, 0.5e-3]) ** 2
    for prior in (None, 0.25 * np.eye(3)):
        for axes in panels(np.full(3, moved), np.zeros(3), posterior, prior):
            (curve,) = [line for line in axes.lines if line.get_label() == "known after"]
            span = np.ptp(curve.get_xydata(), axis=0).max()
            panel = np.ptp(axes.get_xlim())
            assert 0.15 * panel < span < 0.8 * panel
            assert np.ptp(axes.get_ylim()) == pytest.approx(panel)


def test_a_point_that_moved_within_its_panel_is_drawn_where_it_was():
    axes = panels(np.array([3e-3, 0.0, 1e-3]), np.zeros(3), 1e-6 * np.eye(3))[1]
    (mark,) = [line for line in axes.lines if line.get_label() == "before"]
    assert mark.get_xydata()[0] == pytest.approx([3.0, 1.0])


def test_an_ellipse_holds_95_percent_of_what_the_covariance_says():
    root = np.array([[1.0, 0.0, 0.0], [0.8, 0.3, 0.0], [0.1, 0.2, 0.5]]) * 1e-3
    axes = panels(np.zeros(3), np.zeros(3), root @ root.T)[0]
    (curve,) = [line for line in axes.lines if line.get_label() == "known after"]
    scaled = np.linalg.inv(1e3 * root[:2, :2]) @ curve.get_xydata().T
    assert np.linalg.norm(scaled, axis=0) == pytest.approx(np.full(73, 2.4477))
    assert 1.0 - np.exp(-0.5 * 2.4477**2) == pytest.approx(0.95, abs=1e-5)


def test_residuals_and_what_was_learnt_are_drawn():
    rng = np.random.default_rng(0)
    residual, left_out = rng.normal(0.0, 1e-3, (50, 2)), np.zeros((50, 2), dtype=bool)
    residual[3, 0], left_out[3, 0] = 0.5, True
    figure = draw_residuals("r", np.arange(50.0), residual, left_out, ["a", "b"], label="time [s]")
    assert np.ptp(figure.axes[0].get_ylim()) < 20.0  # [mm]; the blunder is at the edge
    assert "RMS" in figure.axes[1].get_title()
    learnt = draw_learnt("r", ESTIMATE)
    assert len(learnt.axes[0].patches) == 5  # those that had a prior
