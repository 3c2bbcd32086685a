"""Animation of the same move under up to three controllers: cables by tension, error below."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.pictures.motions import Motion
from carosac_toolkit.pictures.style import CONTROLLER_NUMBERS, REST_COLOR, looks_by_name
from carosac_toolkit.robot.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRAMES_PER_SECOND = 20
FRAMES_MAX = 300  # of longer motions a time lapse is shown
LAST_FRAME_FRAMES = 24  # for which the last picture stays
FIGURE_INCHES, DOTS_PER_INCH = (10.0, 6.7), 96
WEBP_QUALITY, WEBP_METHOD = 70, 4
TRAIL_FRAMES = 24  # of the trail behind the platform
VIEW_AZIMUTH, VIEW_ELEVATION = np.radians(9.0), np.radians(7.0)
MARGIN_SIZES = 1.3  # sizes of the platform between its way and the edge of the view
VIEW_HEIGHT = 1.12  # of the width of the view
GROUND_COLOR = "#f4f5f7"
FIGURE_SPACE = "\u2007"  # as wide as a digit
LIGHT = np.array([0.3, -0.6, 0.75])
PLATFORM_COLOR = np.array([0.30, 0.33, 0.38])
FRAME_COLOR, PATH_COLOR, SLACK_COLOR = "#3a3a3a", "#8a8a8a", "#b9bfc7"
TENSION_MAP = "plasma_r"
CONTROLLER_WORDS = {
    "kinematic_solver": "kinematic solver", "straight_line": "straight-line model",
    "input_shaping": "input shaping", "mpc": "MPC", "td3": "learned policy (TD3)",
    "approximate_mpc": "approximate MPC",
}  # fmt: skip
BOX_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


def animation_webp(motions: Sequence[Motion]) -> bytes:
    """Draw motions side by side, as an animated WebP that repeats.

    In real time, or as a time lapse, which the picture states, if that would take more than
    `FRAMES_MAX` frames or more than there are samples.

    Args:
        motions: Of one robot on one path, one to three.
    """
    from PIL import Image

    film = _Film(motions)
    duration = [round(1e3 / FRAMES_PER_SECOND)] * film.n_frames
    duration[-1] *= LAST_FRAME_FRAMES
    with io.BytesIO() as buffer:
        Image.fromarray(film.pixels(0)).save(
            buffer, "WEBP", save_all=True, append_images=[_LaterFrames(film)], duration=duration,
            loop=0, quality=WEBP_QUALITY, method=WEBP_METHOD,
        )  # fmt: skip
        return buffer.getvalue()


class _Film:
    """Frames of motions, each drawn when it is asked for.

    Attributes:
        n_frames: Their number, 1 or more.
        lapse: How many times faster than real time they play, >= 1.
    """

    def __init__(self, motions: Sequence[Motion]) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        followed = _followed(motions)
        end = min(float(motion.time[-1]) for motion in followed)
        most = min(FRAMES_MAX, *(len(motion.time) for motion in followed))
        self.lapse = max(1, math.ceil(end * FRAMES_PER_SECOND / most))
        count = math.ceil(end * FRAMES_PER_SECOND / self.lapse - 1e-9)  # rounding adds no frame
        self.n_frames = max(1, count)
        time = np.arange(self.n_frames) * self.lapse / FRAMES_PER_SECOND
        figure = Figure(figsize=FIGURE_INCHES, dpi=DOTS_PER_INCH, facecolor="white")
        self._canvas: Any = FigureCanvasAgg(figure)
        sampled = [motion.at(time) for motion in motions]
        self._stage = _Stage(figure, motions, sampled, self.lapse)

    def pixels(self, k: int) -> Any:
        """Draw frame `k`; return its colours, shape (height, width, 3)."""
        self._stage.show(k)
        self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()


class _LaterFrames:
    """All frames but the first, as an image that Pillow seeks through: one is in memory."""

    def __init__(self, film: _Film) -> None:
        self._film = film
        self._image: Any = None
        self.n_frames = film.n_frames - 1

    def seek(self, k: int) -> None:
        """Draw a frame."""
        from PIL import Image

        self._image = Image.fromarray(self._film.pixels(k + 1))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_image"], name)


class _Stage:
    """Figure with one panel a motion and the errors below; `show` moves it to a time."""

    def __init__(
        self, figure: Figure, whole: Sequence[Motion], sampled: Sequence[Motion], lapse: int
    ) -> None:
        self._pace = "real time" if lapse == 1 else f"{lapse} x real time"
        self._time = sampled[0].time
        self._views = _View.of(whole)
        grid = figure.add_gridspec(
            2, len(whole), height_ratios=(3.3, 1.0), left=0.07, right=0.985, bottom=0.08,
            top=0.858, wspace=0.04, hspace=0.36,
        )  # fmt: skip
        self._clock = figure.text(0.985, 0.962, "", ha="right", va="center", fontsize=12,
                                  family="monospace")  # fmt: skip
        figure.text(0.015, 0.962, _title(whole[0]), va="center", fontsize=14, weight="bold")
        figure.text(0.015, 0.926, _subtitle(whole[0]), va="center", fontsize=10.5, color="0.35")
        colors = _TensionColors(whole[0].plant)
        ends = [float(motion.time[-1]) for motion in whole]
        names = [motion.controller for motion in whole]
        inks = [look.color for look in looks_by_name(names, CONTROLLER_NUMBERS)]
        self._panels = [
            _Panel(figure.add_subplot(grid[0, k]), motion, end, self._views, colors, color)
            for k, (motion, end, color) in enumerate(zip(sampled, ends, inks, strict=True))
        ]
        for panel, motion in zip(self._panels, whole, strict=True):
            words = _words(motion) + (" (diverged)" if motion.diverged else "")
            panel.axes.set_title(words, fontsize=12.5, color=panel.color, weight="bold")
        self._errors = _Errors(figure.add_subplot(grid[1, :]), whole, inks)
        colors.draw_bar(figure)

    def show(self, k: int) -> None:
        """Show sample `k`."""
        for panel in self._panels:
            panel.show(k)
        self._errors.show(float(self._time[k]))
        self._clock.set_text(f"{self._time[k]:.2f} s, {self._pace}")


class _View:
    """Parallel projection that shows all that moves, and as much of the cables as fits.

    Args:
        right, up, toward: Axes of the picture and towards the viewer in W, each (3,).
    """

    def __init__(self, right: Array, up: Array, toward: Array) -> None:
        self.right, self.up, self.toward = right, up, toward
        self.limits = np.zeros((2, 2))

    @classmethod
    def of(cls, motions: Sequence[Motion]) -> _View:
        """Look across the move, from a little above and beside."""
        move = motions[0].reference[-1] - motions[0].reference[0]
        heading = np.arctan2(move[1], move[0]) % np.pi if np.hypot(*move[:2]) > 0.0 else 0.0
        side = heading - VIEW_AZIMUTH
        right = np.array([np.cos(side), np.sin(side), 0.0])
        back = np.array([-np.sin(side), np.cos(side), 0.0])
        up = np.array([0.0, 0.0, np.cos(VIEW_ELEVATION)]) + np.sin(VIEW_ELEVATION) * back
        view = cls(right, up, np.cross(right, up))
        flat = view.project(np.vstack([motion.position for motion in _followed(motions)]))
        margin = MARGIN_SIZES * float(np.ptp(motions[0].plant.anchor_points, axis=0).max())
        low = flat.min(axis=0) - [margin, 1.7 * margin]  # a line of text stands below
        high = flat.max(axis=0) + margin
        high[1] = low[1] + max(high[1] - low[1], VIEW_HEIGHT * (high[0] - low[0]))
        view.limits = np.stack([low, high])
        return view

    def project(self, points: Array) -> Array:
        """Project points in W, shape (..., 3), onto the picture, shape (..., 2)."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)


class _TensionColors:
    """Colours of tensions within the limits of a robot, n cables, each with limits of its own."""

    def __init__(self, robot: Robot) -> None:
        from matplotlib import colormaps
        from matplotlib.colors import LogNorm, Normalize

        self._low, self._high = robot.tension_min, robot.tension_max
        self._positive = self._low[self._low > 0.0]
        highest = float(self._high.max())
        if self._positive.size:
            self.norm: Normalize = LogNorm(float(self._positive.min()), highest)
        else:
            self.norm = Normalize(0.0, highest)
        self.map = colormaps[TENSION_MAP].with_extremes(under=SLACK_COLOR, over="black")

    def of(self, tension: Array) -> Any:
        """Return colours of the tensions of the cables, shape (..., n), as (..., n, 4)."""
        scaled = self.norm(np.clip(tension, self.norm.vmin, self.norm.vmax))
        place = np.where(tension < self._low, -np.inf, scaled)
        return self.map(np.where(tension > self._high, np.inf, place))

    def slack_words(self) -> str:
        """Say below which tension a cable is grey, or nothing if all may be slack."""
        if not self._positive.size:
            return ""
        least, most = float(self._low.min()), float(self._low.max())
        if least == most:
            return f"; grey: slack, below {most:g} N"
        return "; grey: slack, below its own limit"

    def draw_bar(self, figure: Figure) -> None:
        """Draw the scale under the panels."""
        from matplotlib.cm import ScalarMappable

        axes = figure.add_axes((0.42, 0.29, 0.45, 0.016))
        bar = figure.colorbar(
            ScalarMappable(self.norm, self.map), cax=axes, orientation="horizontal",
            extend="both" if self._positive.size else "max",
        )  # fmt: skip
        lowest, highest = self.norm.vmin or 0.0, self.norm.vmax or 0.0
        marks = _round_numbers(lowest, highest)
        bar.set_ticks(marks, labels=[f"{x:g}" for x in marks])
        bar.ax.tick_params(labelsize=9, length=2, pad=1)
        bar.ax.minorticks_off()
        words = f"cable tension [N]{self.slack_words()}"
        figure.text(0.40, 0.297, words, ha="right", va="center", fontsize=10)


class _Panel:
    """One robot: frame, cables, platform, path and trail; it stays as it was when its run ended."""

    def __init__(
        self, axes: Any, motion: Motion, end: float, view: _View, colors: _TensionColors, color: str
    ) -> None:
        from matplotlib.collections import LineCollection, PolyCollection

        self.axes, self.color = axes, color
        self._motion, self._end, self._view, self._colors = motion, end, view, colors
        self._box = _platform_box(motion.plant)
        axes.set(xlim=view.limits[:, 0], ylim=view.limits[:, 1], aspect="equal")
        axes.set(xticks=[], yticks=[], facecolor=GROUND_COLOR)
        axes.spines[:].set_visible(False)
        exits = view.project(motion.plant.exit_points)
        axes.plot(*exits.T, "s", color=FRAME_COLOR, ms=5, zorder=3)
        path = view.project(motion.reference)
        axes.plot(*path.T, color=PATH_COLOR, lw=1.2, ls=(0, (4, 3)), zorder=1)
        axes.plot(*path[[0, -1]].T, "|", color=PATH_COLOR, ms=9, zorder=1)
        self._trail: Any = LineCollection([], lw=2.0, zorder=2)
        self._cables: Any = LineCollection([], lw=2.4, capstyle="round", zorder=4)
        self._platform: Any = PolyCollection([], edgecolor="white", lw=0.6, zorder=5)
        (self._target,) = axes.plot([], [], "o", mfc="none", mec="black", mew=1.2, ms=7, zorder=6)
        for artist in (self._trail, self._cables, self._platform):
            axes.add_collection(artist)
        self._text = axes.text(0.5, 0.03, "", transform=axes.transAxes, ha="center", fontsize=11.5,
                               color=color, weight="bold")  # fmt: skip

    def show(self, k: int) -> None:
        """Show sample `k`."""
        from matplotlib.colors import to_rgba

        motion, view = self._motion, self._view
        self._cables.set_segments(list(view.project(motion.cables[k])))
        self._cables.set_color(self._colors.of(motion.tension[k]))
        corners = motion.position[k] + self._box @ motion.rotation[k].T
        faces, shades = _lit_faces(corners, view.toward)
        self._platform.set_verts([view.project(face) for face in faces])
        self._platform.set_facecolor(shades)
        first = max(0, k - TRAIL_FRAMES)
        trail = view.project(motion.position[first : k + 1])
        pieces = np.stack([trail[:-1], trail[1:]], axis=1)
        fading = np.tile(to_rgba(self.color), (len(pieces), 1))
        fading[:, 3] = np.linspace(0.05, 0.8, len(pieces))
        self._trail.set_segments(list(pieces))
        self._trail.set_color(fading)
        target = view.project(motion.reference[k])
        self._target.set_data([target[0]], [target[1]])
        ended = f", ended at {self._end:.1f} s" if motion.time[k] > self._end else ""
        self._text.set_text(f"{1e3 * motion.error[k]:{FIGURE_SPACE}>3.0f} mm off{ended}")


class _Errors:
    """Distance from the path over time, up to now."""

    def __init__(self, axes: Any, motions: Sequence[Motion], inks: Sequence[str]) -> None:
        self._axes, self._motions = axes, motions
        moving = float(motions[0].time[_arrival(motions[0])])
        axes.axvspan(moving, float(motions[0].time[-1]), color=REST_COLOR, zorder=0, lw=0)
        top = 1.25e3 * max(float(motion.error.max()) for motion in _followed(motions))
        axes.set(xlim=(0.0, motions[0].time[-1]), ylim=(0.0, top))
        for start, words in ((0.0, "reference moves"), (moving, "reference rests")):
            axes.annotate(
                words, (start, 1.0), xycoords=("data", "axes fraction"), xytext=(6, -4),
                textcoords="offset points", va="top", fontsize=10, color="0.45",
            )  # fmt: skip
        axes.set_xlabel("time [s]", fontsize=10, labelpad=1)
        axes.set_ylabel("position error [mm]", fontsize=10)
        axes.tick_params(labelsize=9)
        axes.spines[["top", "right"]].set_visible(False)
        self._lines = [axes.plot([], [], color=ink, lw=2.0)[0] for ink in inks]
        self._now = axes.axvline(0.0, color="0.3", lw=0.8)

    def show(self, now: float) -> None:
        """Show the errors up to a time [s]."""
        for line, motion in zip(self._lines, self._motions, strict=True):
            past = motion.time <= now + 1e-9
            line.set_data(motion.time[past], 1e3 * motion.error[past])
        self._now.set_xdata([now, now])


def _title(motion: Motion) -> str:
    """Say what is seen."""
    distance = float(np.linalg.norm(np.diff(motion.reference, axis=0), axis=1).sum())
    return (
        f"{motion.plant.name}, simulated: {distance:.1f} m in "
        f"{motion.time[_arrival(motion)]:.1f} s, then rest"
    )


def _subtitle(motion: Motion) -> str:
    """Say what the motions have in common."""
    estimator = f"{motion.estimator.replace('_', ' ')} on {motion.sensors}"
    return f"same plant, wind and noise; {estimator}; circle: where it should be"


def _followed(motions: Sequence[Motion]) -> Sequence[Motion]:
    """Return the motions that scales and duration fit: those that did not diverge, or all."""
    return [motion for motion in motions if not motion.diverged] or motions


def _words(motion: Motion) -> str:
    """Return the name of a controller as a reader knows it."""
    return CONTROLLER_WORDS.get(motion.controller, motion.controller)


def _arrival(motion: Motion) -> int:
    """Return the sample at which the reference comes to its last rest."""
    away = np.linalg.norm(motion.reference - motion.reference[-1], axis=1) > 1e-4
    return int(np.flatnonzero(away).max(initial=-1)) + 1


def _round_numbers(low: float, high: float) -> list[float]:
    """Return 1, 2 and 5 times the powers of ten between two numbers."""
    exponents = range(-3, 7)
    numbers = [step * 10.0**exponent for exponent in exponents for step in (1, 2, 5)]
    return [x for x in numbers if 0.999 * low <= x <= 1.001 * high]


def _platform_box(robot: Robot) -> Array:
    """Return the corners of a box from the anchor points down, in P [m], shape (8, 3)."""
    low, high = robot.anchor_points.min(axis=0), robot.anchor_points.max(axis=0)
    least = 0.15 * float((high - low).max())
    for axis in range(3):
        middle = robot.center_of_mass[axis] if axis == 2 else (low[axis] + high[axis]) / 2
        reach = max(high[axis] - middle, middle - low[axis], least)
        low[axis], high[axis] = middle - reach, middle + reach
    ends = np.stack([low, high])
    picks = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    return np.asarray(ends[picks, np.arange(3)])


def _lit_faces(corners: Array, toward: Array) -> tuple[list[Array], Array]:
    """Return the faces that the viewer sees, each (4, 3), and their colours."""
    faces, shades = [], []
    middle = corners.mean(axis=0)
    for face in BOX_FACES:
        points = corners[list(face)]
        normal = np.cross(points[1] - points[0], points[2] - points[1])
        normal *= np.sign(normal @ (points.mean(axis=0) - middle)) / np.linalg.norm(normal)
        if normal @ toward > 0.0:
            light = 0.75 + 0.45 * max(0.0, float(normal @ LIGHT))
            faces.append(points)
            shades.append(np.clip(PLATFORM_COLOR * light, 0.0, 1.0))
    return faces, np.array(shades)
