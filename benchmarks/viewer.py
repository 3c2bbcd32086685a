"""The viewer beside a live loop of eight cables: pictures a second, and what it costs the loop.

``python -m benchmarks.viewer [seconds]``, per row; 20 s is what RESULTS.md shows. The rows take
turns, so that other programs on the machine weigh on all of them alike. Chromium is left out where
it is not installed.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import carosac_toolkit as ct
from benchmarks.results import table, write_section
from carosac_toolkit.live.hand_target import HandTarget
from carosac_toolkit.live.real_time import take_priority
from carosac_toolkit.loop import plugins
from carosac_toolkit.loop.loop import Step, run
from carosac_toolkit.viewer.live import follow
from carosac_toolkit.viewer.page_process import PageOptions, PageProcess

SECONDS = 20.0
TURNS = 4  # of each row
PERIOD = 0.01  # [s]
ROBOT = "cogiro"
PORT = 8760
CLIENT = """
import sys, time
from websockets.sync.client import connect
seen = size = 0
with connect(sys.argv[1], subprotocols=[sys.argv[2]], max_size=None) as socket:
    print("connected", flush=True)
    began = time.monotonic()
    while (left := began + float(sys.argv[3]) - time.monotonic()) > 0:
        try:
            size += len(socket.recv(timeout=left))
            seen += 1
        except TimeoutError:
            break
print(seen / float(sys.argv[3]), size / float(sys.argv[3]))
"""


@dataclass
class Found:
    """What one row has shown, over its turns."""

    cycles: int = 0
    missed: int = 0
    late: list[float] = field(default_factory=list)
    busy: list[float] = field(default_factory=list)
    drawn: list[float] = field(default_factory=list)
    shown: list[float] = field(default_factory=list)


class Timed:
    """A driver that notes when each cycle ends [s]."""

    def __init__(self, driver: Any) -> None:
        self._driver = driver
        self.ends: list[float] = []
        self.busy: list[float] = []
        self._woke = time.monotonic()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._driver, name)

    def measure(self) -> Any:
        """A cycle begins."""
        self._woke = time.monotonic()
        self.ends.append(self._woke)
        return self._driver.measure()

    def command(self, command: Any) -> Any:
        """A cycle is done, but for the wait."""
        sent = self._driver.command(command)
        self.busy.append(time.monotonic() - self._woke)
        return sent


def parts() -> tuple[Any, Any, Any, HandTarget]:
    """Driver in real time, estimator, controller and target of the robot."""
    robot = ct.load_robot(ROBOT)
    kind = plugins.load("drivers", "simulator")
    driver = kind.build(robot, kind.Settings(period=PERIOD, real_time=True, cables="catenary"))
    controller = plugins.load("controllers", "kinematic_solver")
    made = controller.build(robot, controller.Settings(period=PERIOD))
    estimator = plugins.load("estimators", "kinematic_solver").build(robot)
    target = HandTarget(robot, robot.home_position, speed_max=0.5, acceleration_max=0.5)
    return Timed(driver), estimator, made, target


def wander(target: HandTarget, over: threading.Event) -> None:
    """Move a target from corner to corner."""
    corners = [[1.5, 1.0, 1.2], [-1.5, 1.0, 1.8], [-1.5, -1.0, 1.2], [1.5, -1.0, 1.8]]
    k = 0
    while not over.wait(2.0):
        target.go_to(np.array(corners[k % len(corners)]))
        k += 1


def alone(seconds: float) -> tuple[Any, float, float]:
    """The loop without any viewer."""
    driver, estimator, controller, target = parts()
    over = threading.Event()
    threading.Thread(target=wander, args=(target, over), daemon=True).start()
    run(driver, estimator, controller, target, duration=seconds, keep=1, watch=_ignore)
    over.set()
    return driver, np.nan, np.nan


def _ignore(step: Step) -> None:
    """Nothing."""


def viewed(
    seconds: float, watch: Callable[[str, float], Callable[[], float]], *, plain: bool = False
) -> Any:
    """The loop with a page, as the command has it, and with somebody who looks at it."""
    driver, estimator, controller, target = parts()
    options = PageOptions(
        robot=ct.load_robot(ROBOT), title=ROBOT, host="127.0.0.1", port=PORT, plain=plain
    )
    page = PageProcess(options, target.go_to)
    over = threading.Event()
    shown = watch(page.url, seconds)
    threading.Thread(target=wander, args=(target, over), daemon=True).start()
    _, error = follow(page.instants, driver, estimator, controller, target, duration=seconds)
    over.set()
    assert error is None, error
    rate = shown()
    page.close()
    return driver, page.drawn / seconds, rate


def first(take: Callable[[float], Any], seconds: float) -> Any:
    """With the priority of ``carosac view --priority``, in a thread that ends with it."""
    found: list[Any] = []

    def with_priority() -> None:
        take_priority("benchmark", inherited=False)
        found.append(take(seconds))

    thread = threading.Thread(target=with_priority)
    thread.start()
    thread.join()
    return found[0]


def nobody(url: str, seconds: float) -> Callable[[], float]:
    """No browser is there."""
    return lambda: float("nan")


def reader(url: str, seconds: float) -> Callable[[], float]:
    """A process that takes all messages, as a browser on another machine would."""
    import viser

    protocol = f"viser-v{viser.__version__}"
    words = [sys.executable, "-c", CLIENT, url.replace("http", "ws"), protocol, str(seconds)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and "connected" in process.stdout.readline()
    return lambda: float(process.communicate(timeout=30.0)[0].split()[0])


def chromium(url: str, seconds: float) -> Callable[[], float]:
    """Chromium on this machine, which draws with the processor where there is no GPU."""
    from tests.viewer.browser import browser, wait_for

    context = browser(1000, 700)
    window = context.__enter__()
    window.get(url)
    wait_for(lambda: window.find_elements("tag name", "canvas"), "a canvas")
    time.sleep(3.0)  # the first frames compile shaders
    window.set_script_timeout(2.0 * seconds + 60.0)
    rates: list[float] = []

    def count() -> None:
        found = window.execute_async_script(
            "const [last, done] = arguments; let n = 0; const start = performance.now();"
            "function one() { n++; const now = performance.now() - start;"
            "if (now > last) done(1000 * n / now); else requestAnimationFrame(one) }"
            "requestAnimationFrame(one)",
            1000.0 * seconds,
        )
        rates.append(float(found))

    thread = threading.Thread(target=count)
    thread.start()

    def shown() -> float:
        thread.join()
        context.__exit__(None, None, None)
        return rates[0]

    return shown


def rows() -> dict[str, Callable[[float], Any]]:
    """What is measured."""
    from tests.viewer.browser import missing

    found: dict[str, Callable[[float], Any]] = {
        "no viewer": alone,
        "page, nobody looks": lambda seconds: viewed(seconds, nobody),
        "page, a client process reads all": lambda seconds: viewed(seconds, reader),
    }
    if missing() is None:
        found["page, Chromium draws it"] = lambda seconds: viewed(seconds, chromium)
        found["`--plain`, Chromium"] = plain = lambda seconds: viewed(seconds, chromium, plain=True)
        found["no viewer, `--priority`"] = lambda seconds: first(alone, seconds)
        found["`--plain --priority`, Chromium"] = lambda seconds: first(plain, seconds)
    else:
        print(f"without Chromium: {missing()}")
    return found


def measured(seconds: float) -> dict[str, Found]:
    """All rows, in turns."""
    alone(1.0)  # loads kernels
    found = {name: Found() for name in rows()}
    for turn in range(TURNS):
        for name, take in rows().items():
            driver, drawn, shown = take(seconds / TURNS)
            row = found[name]
            row.cycles += len(driver.ends)
            row.missed += driver.overruns
            row.late += list(np.diff(driver.ends) - PERIOD)
            row.busy += driver.busy
            row.drawn.append(drawn)
            row.shown.append(shown)
            print(f"turn {turn + 1}/{TURNS}: {name}: {driver.overruns} missed", flush=True)
    return found


def _said(name: str, row: Found) -> list[str]:
    """One row of the table."""
    middle, worst = np.quantile(row.busy, [0.5, 0.99])
    late = np.quantile(np.abs(row.late), 0.99)
    rates = [np.mean(x) for x in (row.drawn, row.shown)]
    return [
        name, str(row.cycles), f"{100.0 * row.missed / row.cycles:.2f} %",
        f"{1e3 * late:.2f}", f"{1e3 * middle:.2f}", f"{1e3 * worst:.2f}",
        *("-" if np.isnan(x) else f"{x:.1f}" for x in rates),
    ]  # fmt: skip


def main() -> None:
    """Measure, print, and write into RESULTS.md."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    found = measured(seconds)
    header = [
        "", "cycles", "ticks missed", "jitter p99 [ms]", "cycle p50 [ms]", "cycle p99 [ms]",
        "pictures/s drawn", "messages or browser frames/s",
    ]  # fmt: skip
    body = (
        f"Robot `{ROBOT}` (8 cables) simulated in real time with catenaries, `kinematic_solver` as "
        f"estimator and controller at {1.0 / PERIOD:g} Hz, a target that wanders. A cycle is from "
        "waking up to the command sent, without the simulation itself. Of a client process the "
        "messages received are counted, one a picture; of Chromium the frames it draws (without a "
        "GPU, on the same two cores), of which some show no new picture.\n\n"
    ) + table(header, [_said(name, row) for name, row in found.items()])
    print(body)
    command = f"python -m benchmarks.viewer {seconds:g}"
    write_section("viewer", "The viewer beside a live loop", command, body)


if __name__ == "__main__":
    main()
