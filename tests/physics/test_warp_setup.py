import subprocess
import sys
import threading
from types import ModuleType

import warp as wp

from carosac_toolkit.physics import warp_setup


def test_modules_that_threads_load_at_once_are_all_loaded_silently(monkeypatch):
    warp_setup.initialise()
    levels, overlap = [], threading.Event()

    def load(module, device):
        levels.append(wp.config.log_level)
        overlap.wait(0.05)
        levels.append(wp.config.log_level)

    monkeypatch.setattr(wp, "load_module", load)
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_INFO)
    modules = [ModuleType(f"kernels_{k}") for k in range(2)]
    threads = [threading.Thread(target=warp_setup.load, args=(one,)) for one in modules]
    for thread in threads:
        thread.start()
        overlap.wait(0.02)
    for thread in threads:
        thread.join()
    for one in modules:
        warp_setup._loaded.discard((one.__name__, "cpu"))
    assert set(levels) == {wp.LOG_WARNING} and len(levels) == 4
    assert wp.config.log_level == wp.LOG_INFO


def test_the_first_cable_of_a_process_is_computed_without_a_word():
    script = """
import carosac_toolkit as ct
from carosac_toolkit.physics.cable.straight_line import straight_length

robot = ct.load_robot("carosac")
straight_length(robot, robot.home_position[None])
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
