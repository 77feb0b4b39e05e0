"""Writing a bag of which a kill costs little."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import cast

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter


class SteadyWriter(Writer):
    """Writes an mcap bag, chunks compressed by zstd.

    What came before the last ``save`` can be read whatever happens: by ``close`` as a sound bag,
    after ``give_up`` or a kill as one without index, as ``salvage`` reads it.
    """

    def __init__(self, path: Path) -> None:
        """Remember the bag's directory; ``open`` creates it."""
        super().__init__(path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
        self.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._whole = 0

    @property
    def _mcap(self) -> McapWriter:
        return cast("McapWriter", self.storage)

    def save(self) -> None:
        """Put all messages so far on the disk, as a chunk of their own.

        Raises:
            OSError: they cannot be written; then nothing else is left to do but ``give_up``.
        """
        if self._mcap.chunk.msgs:
            self._mcap.close_chunk()
        self._mcap.bio.flush()
        os.fsync(self._mcap.bio.fileno())
        self._whole = self._mcap.bio.tell()

    def give_up(self) -> None:
        """End the file behind what was saved last, without index and metadata.yaml."""
        path = self._mcap.path
        with suppress(OSError):
            # What it still holds cannot be written either.
            self._mcap.bio.close()
        with suppress(OSError):
            os.truncate(path, self._whole)
        self.storage = None
