"""Export of a robot or of runs to one HTML file that needs no server and no network."""

from __future__ import annotations

import base64
import html
import io
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.files import replacing
from carosac_toolkit.viewer.colors import CABLE_COLORS, hex_of, legend_html
from carosac_toolkit.viewer.page import Page
from carosac_toolkit.viewer.replay import Replay
from carosac_toolkit.viewer.runs import RecordedRun

EXPORT_FRAME_RATE_HZ = 25.0  # pictures a second
EXPORT_FRAMES_MAX = 1500  # pictures in a file
PANEL_STYLE = (
    "position:fixed;left:12px;top:12px;width:300px;max-height:calc(100vh - 110px);overflow:auto;"
    "background:rgba(255,255,255,.93);border:1px solid #d5d8dd;border-radius:6px;"
    "padding:10px 4px 8px;font:13px/1.4 sans-serif;color:#222;z-index:1000"
)


def still_html(page: Page, title: str, words: str) -> str:
    """Return the current scene as a page."""
    return _with_panel(page.server.get_scene_serializer().as_html(), page, title, words, None)


def replay_html(page: Page, replay: Replay, title: str, words: str) -> tuple[str, int]:
    """Return a run, and its ghost, as a page with a time line.

    Returns:
        The page, and how many pictures it holds.
    """
    run = replay.run
    longest = max(run.duration, 0.0 if replay.ghost is None else replay.ghost.duration)
    count = int(np.clip(round(longest * EXPORT_FRAME_RATE_HZ), 1, EXPORT_FRAMES_MAX))
    times = np.linspace(0.0, longest, count + 1)
    replay.draw(0.0)
    replay.draw_whole_ways()
    serializer = page.server.get_scene_serializer()
    for before, now in pairwise(times):
        serializer.insert_sleep(float(now - before))
        replay.draw_pictures(float(now))
    return _with_panel(serializer.as_html(), page, title, words, run), count + 1


def write_html(path: Path, text: str) -> None:
    """Write the page atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _with_panel(page_html: str, page: Page, title: str, words: str, run: RecordedRun | None) -> str:
    """Lay title, legend, text and plots over the scene."""
    lines = "<br>".join(html.escape(words).split("\n"))
    plots = "" if run is None else _plots(run)
    panel = (
        f'<div id="carosac-panel" style="{PANEL_STYLE}"><div style="padding:0 10px"><b>'
        f"{html.escape(title)}</b><br>{lines}</div>{legend_html(page.robot)}{plots}</div>"
    )
    end = page_html.rindex("</body>")
    named = page_html[:end] + panel + page_html[end:]
    return named.replace("<title>Viser</title>", f"<title>{html.escape(title)}</title>", 1)


def _plots(run: RecordedRun) -> str:
    """Return tension and error over the whole run, as a picture inside the page."""
    from carosac_toolkit.pictures.drawing import new_figure

    figure: Any = new_figure(3.7, 3.9)
    above, below = figure.subplots(2, 1, sharex=True)
    for i, name in enumerate(run.robot.cable_names):
        color = hex_of(CABLE_COLORS[i % len(CABLE_COLORS)])
        above.plot(run.time, run.tension[:, i], lw=0.9, color=color, label=name)
    below.plot(run.time, 1e3 * run.error, lw=0.9, color="#c8553d")
    above.set_ylabel("tension [N]")
    below.set(ylabel="platform to target [mm]", xlabel="time [s]")
    if np.isfinite(run.tension).any():
        above.legend(fontsize=6, ncols=2, frameon=False)
    for axes in (above, below):
        axes.grid(alpha=0.25)
        axes.tick_params(labelsize=7)
    stream = io.BytesIO()
    figure.savefig(stream, format="svg")
    coded = base64.b64encode(stream.getvalue()).decode("ascii")
    return f'<img alt="tensions and error" width="290" src="data:image/svg+xml;base64,{coded}">'
