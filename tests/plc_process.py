"""An emulated PLC in a process of its own, with an address of its own, for tests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import carosac_toolkit as ct
from carosac_toolkit.loop.values import State
from carosac_toolkit.plc.emulator.client import PlcClient
from carosac_toolkit.robot.file import robot_text
from carosac_toolkit.robot.robot import Robot

_ADDRESSES = count(1)


def robot_at(name: str, ip: str, imu: int | None = None) -> str:
    """The file of a bundled robot with its PLC at an address; millimetres, two cables mirrored."""
    ways = ("{sign: 1, scale: 1 mm, offset: 0.5 m}", "{sign: -1, scale: 1 mm, offset: 25 m}")
    names = ct.load_robot(name).cable_names
    cables = [f"    {cable}: {ways[i % 2]}" for i, cable in enumerate(names)]
    ads = f"  ads: {{net_id: {ip}.1.1, ip: {ip}}}"
    sensor = [] if imu is None else [f"  imu: {{source: udp, port: {imu}, ip: {ip}}}"]
    return "\n".join([robot_text(name), "hardware:", ads, "  cables:", *cables, *sensor, ""])


def own_address() -> str:
    """A loopback address that no other test process uses."""
    pid = os.getpid()
    return f"127.{1 + pid // 200 % 200}.{1 + pid % 200}.{next(_ADDRESSES)}"


class PlcProcess:
    """A running ``carosac plc``.

    Attributes:
        robot: The robot that a host must use.
        file: Its file.
        ip: Address of the PLC.
        process: The process.
    """

    def __init__(
        self, *words: str, ip: str | None = None, name: str = "carosac", imu: int | None = None
    ) -> None:
        self.ip = ip or own_address()
        self._folder = TemporaryDirectory()
        self.file = Path(self._folder.name) / "robot.yaml"
        self.file.write_text(robot_at(name, self.ip, imu))
        self.robot = ct.load_robot(self.file)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "carosac_toolkit.cli.main", "plc", str(self.file), "--control",
             "--priority", *words],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert "ready" in line, line

    def client(self) -> PlcClient:
        """A client beside the driver."""
        return PlcClient(self.robot.n, self.ip)

    def say(self, line: str) -> str:
        """Send a control line; the answer."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().removeprefix("carosac plc: ").strip()

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the process."""
        self.process.send_signal(number)

    def kill(self) -> None:
        """Kill it; nothing is left."""
        self.process.kill()
        self.process.wait(10.0)
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                stream.close()
        self._folder.cleanup()


@contextmanager
def plc_process(
    *words: str, ip: str | None = None, name: str = "carosac", imu: int | None = None
) -> Iterator[PlcProcess]:
    """A PLC for as long as the context lasts; `imu` is the UDP port of its inertial sensor."""
    plc = PlcProcess(*words, ip=ip, name=name, imu=imu)
    try:
        yield plc
    finally:
        plc.kill()


def home_pose(robot: Robot) -> State:
    """The home pose as `home` takes it."""
    return State(
        time=np.zeros(1), position=robot.home_position[None], rotation=robot.home_rotation[None]
    )
