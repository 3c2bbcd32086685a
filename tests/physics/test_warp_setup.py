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
