"""Run a function as another user of this machine, to test that such a user is kept out."""

import encodings.idna
import os
import pickle
from collections.abc import Callable
from typing import Any

import pytest

ANOTHER_UID = 65534
NEEDED = encodings.idna  # another user may not read the library, so it is imported before

as_root = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can become another user"
)


def as_another_user(function: Callable[[], Any]) -> Any:
    """Return what a function returns, or the exception that it raises, in a child with another uid.

    The child may import nothing that is not imported yet.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        try:
            os.setgroups([])
            os.setgid(ANOTHER_UID)
            os.setuid(ANOTHER_UID)
            try:
                answer = function()
            except Exception as error:
                answer = error
            os.write(writing, pickle.dumps(answer))
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        answer = pickle.loads(pipe.read())
    os.waitpid(child, 0)
    return answer
