"""Robot in a viser scene: static parts are drawn once, the rest with every picture."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carosac_toolkit.base.arrays import Array, evenly
from carosac_toolkit.base.rotations import from_matrix
from carosac_toolkit.pictures.robot import box_edges
from carosac_toolkit.robot.robot import Robot
from carosac_toolkit.viewer.colors import Rgb, tension_colors, vertex_colors
from carosac_toolkit.viewer.geometry import extent, platform_box, posts
from carosac_toolkit.viewer.picture import Picture

FRAME_COLOR: Rgb = (70, 74, 82)
PLATFORM_COLOR: Rgb = (200, 85, 61)
HELD_COLOR: Rgb = (150, 150, 150)
GHOST_COLOR: Rgb = (60, 90, 160)
TARGET_COLOR: Rgb = (20, 120, 60)
REFUSED_COLOR: Rgb = (200, 20, 70)
ESTIMATE_COLOR: Rgb = (123, 79, 163)
WORKSPACE_COLOR: Rgb = (170, 175, 182)
TRAIL_PICTURES = 500  # pictures that a trail is long
TRAIL_INTERVAL_PICTURES = 5  # pictures between two drawings of the trails, and of the labels
PLAIN_TRAIL_INTERVAL_PICTURES = 15
PLAIN_TRAIL_POINTS_MAX = 60  # points of a trail that are drawn
PLAIN_CABLE_POINTS = 10  # points of a cable
TRAIL_STEP_MIN_M = 2e-3  # [m], below which a trail does not grow
GHOST_OPACITY = 0.3


class RobotScene:
    """Robot in a scene. Call `show` from one thread at a time.

    Attributes:
        enlarged: Factor on the distance of the cables from their chords.
        trails: True if the ways of platform and target are drawn.
        labels: True if cables are named, with their tensions.
        own_trails: True if trails are the ways of the pictures shown up to now; else somebody
            calls `draw_way`.
    """

    def __init__(
        self, scene: Any, robot: Robot, name: str = "/robot", *, ghost: bool = False,
        plain: bool = False,
    ) -> None:  # fmt: skip
        """Draw the frame; a ghost has none, and is transparent.

        Args:
            scene: `viser.SceneApi`.
            robot: The robot, n cables.
            name: Node in the tree of the scene.
            ghost: True if this is a second run beside another.
            plain: Cheap to draw: without floor, labels only once somebody wants them, exit
                points as dots, cables and trails of fewer points, trails less often.
        """
        self._scene, self._robot, self._name, self._ghost = scene, robot, name, ghost
        self.enlarged = 1.0
        self.trails = self.own_trails = True
        self.labels = not plain
        self._every = PLAIN_TRAIL_INTERVAL_PICTURES if plain else TRAIL_INTERVAL_PICTURES
        self._plain = plain
        self._count = 0
        self._size = float(np.ptp(extent(robot), axis=0).max())
        self._ways: dict[str, deque[Array]] = {
            key: deque(maxlen=TRAIL_PICTURES) for key in ("platform", "target")
        }
        if not ghost:
            self._draw_frame(plain=plain)
        self._platform = self._add_platform()
        grey = vertex_colors(np.tile(np.array(FRAME_COLOR, dtype=np.uint8), (1, 2, 1)))
        # With a colour a vertex from the first: pages that are open keep to that kind.
        self._cables = self._add_lines("cables", np.zeros((1, 2, 3)), grey, 2.0 if ghost else 4.0)
        self._trails = {
            key: self._add_lines(f"trail_{key}", np.zeros((1, 2, 3)), color, 2.0)
            for key, color in (
                ("platform", GHOST_COLOR if ghost else PLATFORM_COLOR),
                ("target", TARGET_COLOR),
            )
        }
        self._names: list[Any] = []  # labels cost even where they cannot be seen: made when wanted
        self._target = self._add_ball("target", TARGET_COLOR, 0.010)
        self._belief = self._add_ball("believed", ESTIMATE_COLOR, 0.008)
        self._colored: Rgb | None = None
        self._visible = True

    def show(self, picture: Picture) -> None:
        """Draw a picture."""
        wxyz = from_matrix(picture.rotation[None])[0]
        self._platform.position, self._platform.wxyz = picture.position, wxyz
        self._draw_cables(picture)
        if not self._ghost:  # its target is mostly that of the run beside it
            self._place(self._target, picture.target)
            self._place(self._belief, picture.believed)
        self._color_target(picture.held)
        if self.own_trails:
            self._remember(picture)
        if self._count % self._every == 0:
            self.settle(picture)
        self._count += 1

    def settle(self, picture: Picture) -> None:
        """Draw trails and labels, which do not come with every picture."""
        if self.own_trails:
            self._draw_trails()
        self._label(picture.tension)

    def forget(self) -> None:
        """Clear the trails."""
        for way in self._ways.values():
            way.clear()
        self._count = 0

    def refresh(self) -> None:
        """Draw trails and labels with the next picture."""
        self._count = 0

    def _draw_trails(self) -> None:
        """Draw the paths of platform and target up to now."""
        for key, way in self._ways.items():
            self.draw_way(key, np.array(way))

    def draw_way(self, key: str, way: Array) -> None:
        """Draw the whole path of ``platform`` or ``target`` at once [m], shape (T, 3)."""
        handle = self._trails[key]
        handle.visible = self.trails and len(way) > 1
        if handle.visible:
            handle.points = segments(
                way[evenly(len(way), PLAIN_TRAIL_POINTS_MAX)] if self._plain else way
            )

    @property
    def visible(self) -> bool:
        """True if the robot is drawn."""
        return self._visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        if visible == self._visible:
            return
        self._visible = visible
        for handle in (self._platform, self._cables, *self._trails.values()):
            handle.visible = visible
        if not visible:
            self._target.visible = self._belief.visible = False

    def _draw_frame(self, *, plain: bool) -> None:
        """Draw the static parts: floor, posts, exit points, axes of W and the workspace box."""
        scene, robot, name = self._scene, self._robot, self._name
        lower, upper = extent(robot)
        axes = 0.06 * self._size
        radius = 0.007 * self._size
        if plain:
            scene.add_point_cloud(
                f"{name}/exits", robot.exit_points, FRAME_COLOR, point_size=2.0 * radius,
                point_shape="circle", precision="float32",
            )  # fmt: skip
        else:
            self._draw_floor(lower, upper)
            self._draw_letters(lower, axes)
            for i, point in enumerate(robot.exit_points):
                scene.add_icosphere(
                    f"{name}/exit_{i}",
                    radius=radius,
                    color=FRAME_COLOR,
                    subdivisions=2,
                    position=point,
                )
        self._add_lines("posts", posts(robot), (190, 193, 199), 2.0)
        self._add_lines("workspace", np.stack(box_edges(robot)), WORKSPACE_COLOR, 1.2)
        scene.add_frame(
            f"{name}/world", axes_length=axes, axes_radius=0.05 * axes,
            position=lower, origin_radius=0.08 * axes,
        )  # fmt: skip

    def _draw_floor(self, lower: Array, upper: Array) -> None:
        """Draw a grid of metres below everything."""
        middle = 0.5 * (lower + upper)
        self._scene.add_grid(
            f"{self._name}/floor", width=1.3 * (upper - lower)[0], height=1.3 * (upper - lower)[1],
            plane="xy", cell_size=1.0, section_size=5.0, cell_thickness=0.6,
            cell_color=(205, 208, 213), section_color=(170, 175, 182), section_thickness=1.0,
            position=(middle[0], middle[1], lower[2]),
        )  # fmt: skip

    def _draw_letters(self, origin: Array, axes: float) -> None:
        """Draw names at the ends of the axes of W, of this length [m]."""
        for k, letter in enumerate("xyz"):
            self._scene.add_label(
                f"{self._name}/axis_{letter}", letter, anchor="center-center",
                position=origin + 1.15 * axes * np.eye(3)[k], font_screen_scale=0.8,
            )  # fmt: skip

    def _add_platform(self) -> Any:
        """Add the platform as a box with its frame; the handle moves it all."""
        size, center = platform_box(self._robot)
        name = f"{self._name}/platform"
        arrow = 0.7 * float(max(size))
        handle = self._scene.add_frame(
            name, show_axes=not self._ghost, axes_length=arrow, axes_radius=0.03 * arrow
        )
        self._box = self._scene.add_box(
            f"{name}/box", dimensions=tuple(size), position=center,
            color=GHOST_COLOR if self._ghost else PLATFORM_COLOR,
            opacity=GHOST_OPACITY if self._ghost else 0.9,
        )  # fmt: skip
        return handle

    def _add_lines(
        self, name: str, points: Array, color: Rgb | NDArray[np.uint8], width: float
    ) -> Any:
        """Add line segments of one colour, or with one a vertex; thickness in pixels."""
        return self._scene.add_line_segments(
            f"{self._name}/{name}", points=np.asarray(points, dtype=np.float32), colors=color,
            thickness=width, thickness_units="screen",
        )  # fmt: skip

    def _add_ball(self, name: str, color: Rgb, size: float) -> Any:
        """Add a hidden ball."""
        return self._scene.add_icosphere(
            f"{self._name}/{name}", radius=size * self._size, color=color, subdivisions=2,
            opacity=GHOST_OPACITY if self._ghost else 0.8, visible=False,
        )  # fmt: skip

    def _add_names(self) -> list[Any]:
        """Add labels of the cables at their exits; coincident ones are stacked."""
        robot = self._robot
        return [
            self._scene.add_label(
                f"{self._name}/name_{i}", robot.cable_names[i], anchor="bottom-center",
                font_screen_scale=0.75,
                position=_above(robot, i, self._size),
            )
            for i, point in enumerate(robot.exit_points)
        ]  # fmt: skip

    def _draw_cables(self, picture: Picture) -> None:
        """Draw all cables as one set of segments, coloured by tension."""
        points = picture.drawn(self.enlarged)
        if self._plain:
            points = points[:, evenly(points.shape[1], PLAIN_CABLE_POINTS)]
        pairs = np.stack([points[:, :-1], points[:, 1:]], axis=2)  # (n, samples - 1, 2, 3)
        colors = tension_colors(self._robot, picture.tension)
        if self._ghost:
            colors = np.asarray(0.45 * colors + 0.55 * 255.0, dtype=np.uint8)
        light = vertex_colors(colors)[:, None, None, :]
        self._cables.points = np.asarray(pairs.reshape(-1, 2, 3), dtype=np.float32)
        self._cables.colors = np.array(np.broadcast_to(light, pairs.shape).reshape(-1, 2, 3))

    def _color_target(self, held: bool) -> None:
        """Draw platform grey and target red if the pose is not the requested one."""
        color = HELD_COLOR if held else PLATFORM_COLOR
        if self._ghost or color == self._colored:
            return
        self._colored = color
        self._box.color = color
        self._target.color = REFUSED_COLOR if held else TARGET_COLOR

    def _place(self, handle: Any, position: Array | None) -> None:
        """Place a ball, or hide it."""
        handle.visible = position is not None
        if position is not None:
            handle.position = position

    def _remember(self, picture: Picture) -> None:
        """Extend the trails."""
        for key, place in (("platform", picture.position), ("target", picture.target)):
            way = self._ways[key]
            if place is not None and (not way or np.abs(place - way[-1]).max() > TRAIL_STEP_MIN_M):
                way.append(np.array(place))

    def _label(self, tension: Array) -> None:
        """Label cables with names and tensions."""
        if self.labels and not self._names and not self._ghost:
            self._names = self._add_names()
        for i, handle in enumerate(self._names):
            handle.visible = self.labels
            value = f"{tension[i]:.0f} N" if np.isfinite(tension[i]) else "? N"
            handle.text = f"{self._robot.cable_names[i]}: {value}"


def segments(way: Array) -> NDArray[np.float32]:
    """Return line segments along a path [m], shape (T - 1, 2, 3)."""
    if len(way) < 2:
        return np.zeros((1, 2, 3), dtype=np.float32)
    return np.asarray(np.stack([way[:-1], way[1:]], axis=1), dtype=np.float32)


def _above(robot: Robot, i: int, size: float) -> Array:
    """Return the position of a cable's name [m]: above its exit, and above earlier names there."""
    away = np.linalg.norm(robot.exit_points[:i] - robot.exit_points[i], axis=1)
    place: Array = robot.exit_points[i].copy()
    place[2] += 0.015 * size * (1.0 + 2.2 * (away < 0.04 * size).sum())
    return place
