"""Chunks of bags: a few kilobytes of one can hold gigabytes."""

from __future__ import annotations

import bz2
from collections.abc import Callable
from typing import Any

CHUNK_BYTES_MAX = 2**26  # decompressed; recorders write about a megabyte


def bound_decompression() -> None:
    """Have `rosbags` stop at the size that a chunk may have; it has no setting for that."""
    import lz4.frame  # type: ignore[import-untyped]
    from rosbags.rosbag1 import reader
    from rosbags.rosbag2 import storage_mcap

    def bounded(decompress: Callable[[bytes], Any]) -> Callable[..., bytes]:
        def limited(data: bytes, _: int = 0) -> bytes:
            content = bytes(decompress(data))
            if len(content) > CHUNK_BYTES_MAX:
                raise ValueError(f"a chunk of more than {CHUNK_BYTES_MAX / 1e6:.0f} MB")
            return content

        return limited

    zstd = vars(storage_mcap)["zstd"]  # of the standard library, or its backport
    most = CHUNK_BYTES_MAX + 1
    of_bz2 = bounded(lambda data: bz2.BZ2Decompressor().decompress(data, most))
    of_lz4 = bounded(lambda data: lz4.frame.LZ4FrameDecompressor().decompress(data, most))
    of_zstd = bounded(lambda data: zstd.ZstdDecompressor().decompress(data, most))
    reader.decompressors |= {"bz2": of_bz2, "lz4": of_lz4}
    storage_mcap.DECOMPRESSORS |= {"lz4": of_lz4, "zstd": of_zstd}
