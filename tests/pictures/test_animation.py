"""The animation shows what the simulator computed, in real time or as a stated time lapse."""

import io
import json
import weakref
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import carosac_toolkit as ct
from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.pictures import animation
from carosac_toolkit.pictures.animation import animation_webp
from carosac_toolkit.pictures.comparison import COMPARISON_PICTURES
from carosac_toolkit.pictures.motions import motions_of
from carosac_toolkit.pictures.style import CONTROLLER_NUMBERS, looks_by_name
from carosac_toolkit.reports.study import check_animation, write_report
from tests.studies.tables import bad, case, good, series

CONTROLLERS = ["straight_line", "kinematic_solver"]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study") / "out"
    return ct.Study(controllers=CONTROLLERS, seeds=1, workers=0, output=folder).run(progress=False)


@pytest.fixture(scope="module")
def motions(results):
    return motions_of(results.folder, results.rows, CONTROLLERS)


def test_cables_hang_between_the_exit_and_anchor_points_of_the_plant_by_their_tensions(motions):
    for motion in motions:
        assert motion.plant.mass != ct.load_robot("carosac").mass  # drawn, not nominal
        anchors = motion.position[:, None] + np.einsum(
            "sij,nj->sni", motion.rotation, motion.plant.anchor_points
        )
        np.testing.assert_allclose(motion.cables[:, :, -1], anchors, atol=1e-6)
        exits = np.broadcast_to(motion.plant.exit_points, anchors.shape)
        np.testing.assert_allclose(motion.cables[:, :, 0], exits, atol=1e-6)
        chord = np.linalg.norm(exits - anchors, axis=-1)
        along = np.linalg.norm(np.diff(motion.cables, axis=2), axis=-1).sum(axis=-1)
        excess = (along - chord) / chord
        taut, slack = excess[motion.tension > 50.0], excess[motion.tension < 0.3]
        assert np.median(taut) < 1e-5 and taut.max() < 2e-3  # cables that swing are not catenaries
        if motion.controller == "kinematic_solver":  # 0.3 N is less than half a cable weighs
            assert len(slack) > 20 and slack.max() > 5e-3


def test_the_error_is_the_distance_from_the_reference(results, motions):
    for motion, row in zip(motions, results.rows, strict=True):
        rms = float(np.sqrt((motion.error**2).mean()))
        assert rms == pytest.approx(row["tracking_rmse_norm_m"], rel=1e-4)


def test_it_plays_in_real_time_and_repeats(motions, monkeypatch):
    monkeypatch.setattr(animation, "FRAMES_PER_SECOND", 4)
    picture = Image.open(io.BytesIO(animation_webp(motions)))
    duration = float(motions[0].time[-1])
    assert picture.n_frames == int(np.ceil(duration * 4))
    shown = []
    for k in range(picture.n_frames):
        picture.seek(k)
        picture.load()
        shown.append(picture.info["duration"])
    assert shown[:-1] == [250] * (len(shown) - 1) and shown[-1] > 250
    assert picture.info["loop"] == 0  # for ever


def test_colours_are_those_of_the_tensions(motions):
    colors = animation._TensionColors(motions[0].plant)  # 5 to 500 N
    tension = np.tile([[0.0], [5.0], [50.0], [500.0], [501.0]], motions[0].plant.n)
    slack, low, middle, high, over = colors.of(tension)[:, 0]
    ends = colors.map(np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose([low, middle, high], ends, atol=0.02)
    assert np.ptp(slack[:3]) < 0.1 and tuple(over[:3]) == (0.0, 0.0, 0.0)  # grey, black
    assert colors.slack_words() == "; grey: slack, below 5 N"


def test_controllers_and_rest_look_as_in_the_other_pictures(results, motions):
    stage = animation._Film(motions)._stage
    looks = dict(zip(CONTROLLERS, looks_by_name(CONTROLLERS, CONTROLLER_NUMBERS), strict=True))
    assert [panel.color for panel in stage._panels] == [looks[x].color for x in CONTROLLERS]
    still = COMPARISON_PICTURES["error_over_time"](results).axes[0]
    (here,), (there,) = stage._errors._axes.patches, still.patches
    assert here.get_facecolor() == there.get_facecolor()
    assert here.get_x() == pytest.approx(there.get_x(), abs=0.1)


def test_each_cable_is_slack_below_its_own_limit():
    robot = ct.load_robot("desktop")  # 4 cables
    low, high = np.array([5.0, 5.0, 5.0, 200.0]), np.array([100.0, 500.0, 500.0, 500.0])
    colors = animation._TensionColors(replace(robot, tension_min=low, tension_max=high))
    assert (colors.norm.vmin, colors.norm.vmax) == (5.0, 500.0)
    *within, slack = colors.of(np.full(4, 50.0))
    assert np.ptp(slack[:3]) < 0.1  # 50 N of at least 200 N
    np.testing.assert_allclose(within, [colors.map(0.5)] * 3, atol=0.02)
    over, *within = colors.of(np.full(4, 300.0))
    assert tuple(over[:3]) == (0.0, 0.0, 0.0) and all(color[:3].max() > 0.1 for color in within)
    assert colors.slack_words() == "; grey: slack, below its own limit"


def test_without_a_lower_limit_no_cable_is_grey():
    robot = ct.load_robot("desktop")
    colors = animation._TensionColors(replace(robot, tension_min=np.zeros(4)))
    assert colors.slack_words() == ""
    np.testing.assert_array_equal(colors.of(np.zeros(4)), np.tile(colors.map(0.0), (4, 1)))
    mixed = replace(robot, tension_min=np.array([0.0, 1.0, 1.0, 1.0]))
    free, *slack = animation._TensionColors(mixed).of(np.full(4, 0.5))
    assert np.ptp(free[:3]) > 0.1 and all(np.ptp(color[:3]) < 0.1 for color in slack)


def test_the_platform_is_drawn_with_the_faces_that_are_seen(motions):
    corners = animation._platform_box(motions[0].plant)
    assert corners[:, 2].max() == pytest.approx(-0.011, abs=0.005)  # anchors on its upper side
    assert corners[:, 2].mean() == pytest.approx(-0.12, abs=0.05)  # centre of mass, drawn
    faces, shades = animation._lit_faces(corners, np.array([0.0, 0.0, 1.0]))
    assert len(faces) == len(shades) == 1
    np.testing.assert_allclose(faces[0][:, 2], corners[:, 2].max())


def test_a_report_shows_it_first(results, motions, monkeypatch):
    monkeypatch.setattr(animation, "FRAMES_PER_SECOND", 1)
    content = animation_webp(motions)
    files = write_report(results, [], ["carosac", "compare"], animation=content)
    assert (results.folder / "animation.webp").read_bytes() == content
    assert results.folder / "animation.webp" in files
    report = (results.folder / "report.html").read_text()
    assert report.index("data:image/webp") < report.index("data:image/png")


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["mcp"], "--animation: got 'mcp'; allowed: of the study: .*did you mean 'mpc'"),
        (["a", "b", "mpc", "c"], "one to 3 different controllers"),
        (["mpc", "mpc"], "one to 3 different controllers"),
    ],
)
def test_an_animation_that_could_not_be_drawn_is_refused(names, message):
    with pytest.raises(InvalidField, match=message):
        check_animation(names, ["a", "b", "c", "mpc"])


def whole_row(which, samples=3, status="ok", step=0.5):
    """A row with a series that has all that a motion needs, of a platform at rest."""
    robot = ct.load_robot("carosac")
    lengths = np.linalg.norm(robot.exit_points - robot.home_position - robot.anchor_points, axis=1)
    channels = {
        "time_s": [step * k for k in range(samples)], "reference_m": robot.home_position + 0.01,
        "position_m": robot.home_position, "quaternion": [1.0, 0.0, 0.0, 0.0],
        "tension_N": np.full(robot.n, 50.0), "unstrained_length_m": lengths,
    }  # fmt: skip
    repeated = {
        name: np.asarray(value).tolist() if name == "time_s" else [list(value)] * samples
        for name, value in channels.items()
    }
    return good(which, (0.1, 0.0, 0.0), series=json.dumps(repeated)) | {"status": status}


def test_all_panels_show_the_same_case(tmp_path):
    failed = bad(case("a", trajectory="line"), "no luck")
    rows = [failed, *(whole_row(case("a", estimator=name)) for name in ("truth", "ekf"))]
    rows += [whole_row(case("b", trajectory="line")), whole_row(case("b", estimator="ekf"))]
    motions = motions_of(tmp_path, rows, ["a", "b"])
    assert [(one.controller, one.estimator) for one in motions] == [("a", "ekf"), ("b", "ekf")]


@pytest.mark.parametrize(
    "other",
    [
        {"trajectory": "line"}, {"estimator": "ekf"}, {"sensors": "lengths+imu"}, {"seed": 1},
        {"perturbation": "wind"}, {"robot": "scampi"},
    ],
)  # fmt: skip
def test_panels_of_different_cases_are_refused(tmp_path, other):
    rows = [whole_row(case("a")), whole_row(case("b", **other))]
    with pytest.raises(CarosacError, match="a, b have no whole runs of the same robot, "):
        motions_of(tmp_path, rows, ["a", "b"])


def test_a_run_that_diverged_is_marked_and_does_not_set_the_scales(tmp_path):
    rows = [whole_row(case("a")), whole_row(case("b"), status="diverged")]
    good_one, lost = motions_of(tmp_path, rows, ["a", "b"])
    assert (good_one.diverged, lost.diverged) == (False, True)
    lost = replace(lost, position=lost.position + 1e3)
    stage = animation._Stage(Figure(), [good_one, lost], [good_one, lost], lapse=1)
    titles = [panel.axes.get_title() for panel in stage._panels]
    assert titles == ["a", "b (diverged)"]
    assert np.ptp(stage._views.limits, axis=0).max() < 10.0  # m


def test_a_run_that_diverged_and_ended_early_does_not_cut_the_others(tmp_path):
    rows = [whole_row(case("a"), 5), whole_row(case("b"), 3, status="diverged")]  # 2 s and 1 s
    film = animation._Film(motions_of(tmp_path, rows, ["a", "b"]))
    assert film.n_frames == 5
    texts = []
    for k in (1, 4):
        film._stage.show(k)
        texts += [panel._text.get_text() for panel in film._stage._panels]
    assert ["ended" in text for text in texts] == [False, False, False, True]
    assert texts[-1].endswith("mm off, ended at 1.0 s")


@pytest.mark.parametrize(
    ("samples", "step", "lapse", "frames"),
    [
        (500, 0.12, 4, 300),  # 60 s would be 1200 frames
        (500, 0.01, 1, 100),
        (50, 0.2, 4, 49),  # 9.8 s would be 196 frames of 50 samples
        (2, 1.0, 10, 2),
    ],
)
def test_no_more_frames_than_samples_or_the_most_and_the_lapse_is_stated(
    tmp_path, samples, step, lapse, frames
):
    (motion,) = motions_of(tmp_path, [whole_row(case("a"), samples, step=step)], ["a"])
    film = animation._Film([motion])
    assert (film.lapse, film.n_frames) == (lapse, frames)
    film._stage.show(frames - 1)
    pace = "real time" if lapse == 1 else f"{lapse} x real time"
    now = (frames - 1) * lapse / animation.FRAMES_PER_SECOND
    assert film._stage._clock.get_text() == f"{now:.2f} s, {pace}"


def test_one_frame_after_the_other_is_in_memory(tmp_path, monkeypatch):
    (motion,) = motions_of(tmp_path, [whole_row(case("a"), 30, step=0.05)], ["a"])
    monkeypatch.setattr(animation, "WEBP_METHOD", 0)
    made, alive = [], []
    convert = Image.fromarray

    def watched(pixels):
        image = convert(pixels)
        made.append(weakref.ref(image))
        alive.append(sum(one() is not None for one in made))
        return image

    monkeypatch.setattr(Image, "fromarray", watched)
    picture = Image.open(io.BytesIO(animation_webp([motion])))
    assert picture.n_frames == len(made) == 29
    assert max(alive) <= 3  # the first, the last one and the new one


@pytest.mark.parametrize("samples", [0, 1])
def test_fewer_than_two_samples_are_refused(tmp_path, samples):
    message = f"samples of a: got {samples}; allowed: at least 2"
    with pytest.raises(InvalidField, match=message):
        motions_of(tmp_path, [whole_row(case("a"), samples)], ["a"])


def test_a_run_without_tensions_and_lengths_is_refused(tmp_path):
    row = good(case("a"), (0.1, 0.0, 0.0), series=series(0.1))
    row["series"] = row["series"].replace("}", ', "quaternion": null}')
    with pytest.raises(CarosacError, match="no run of a has poses, tensions and lengths"):
        motions_of(tmp_path, [row], ["a"])
