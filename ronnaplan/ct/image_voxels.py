"""The voxels of an image file: unpacked, scaled to HU, slice by slice."""

from __future__ import annotations

import bz2
import io
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, BinaryIO, Final, cast

import numpy as np

from ronnaplan.bounds import LARGEST_HU
from ronnaplan.ct.files import DamagedError, open_regular
from ronnaplan.ct.flags import Voxels
from ronnaplan.ct.image_header import ImageHeader, StoredVoxels
from ronnaplan.ct.limits import are_hu, fit_int16

_ZLIB_OR_GZIP: Final = 32 + zlib.MAX_WBITS
_READ_AT_ONCE_BYTES: Final = 1 << 20
UNPACKING_ERRORS: Final = (OSError, EOFError, zlib.error)


def read_voxels(header: ImageHeader, *, k_flips: bool) -> Voxels:
    """Return HU (K, J, I), the last slice first if ``k_flips``: int16 if every value is whole and fits, else float32.

    Raises `DamagedError` unless the file holds exactly the voxels that it declares.
    """
    try:
        with _opened(header) as stream:
            voxels = _filled(header, stream, k_flips)
            if stream.read(1):
                raise DamagedError("it holds more voxels than its header declares; convert it again")
            return voxels
    except UNPACKING_ERRORS as error:
        raise DamagedError("it cannot be read to its end; copy it again") from error
    except MemoryError as error:
        raise DamagedError("its voxels need more memory than there is; choose a smaller scan") from error


def _filled(header: ImageHeader, stream: BinaryIO, k_flips: bool) -> Voxels:
    count, rows, columns = header.shape
    voxels: Voxels = np.empty(header.shape, np.int16)
    for k in range(count)[:: -1 if k_flips else 1]:
        content = stream.read(rows * columns * header.dtype.itemsize)
        if len(content) < rows * columns * header.dtype.itemsize:
            raise EOFError
        plane = _hu(np.frombuffer(content, header.dtype).reshape(rows, columns), header)
        if voxels.dtype == np.int16 and not fit_int16(plane):
            voxels = voxels.astype(np.float32)
        with np.errstate(over="ignore"):
            voxels[k] = plane
        if voxels.dtype != np.int16 and not are_hu(voxels[k]):
            raise DamagedError(
                f"it holds values that are not finite numbers up to {LARGEST_HU:g} HU; convert it again"
            )
    return voxels


def _hu(stored: Any, header: ImageHeader) -> Any:
    if (header.slope, header.intercept) == (1.0, 0.0):
        return stored
    with np.errstate(over="ignore", invalid="ignore"):
        return stored.astype(np.float64) * header.slope + header.intercept


@contextmanager
def _opened(header: ImageHeader) -> Iterator[BinaryIO]:
    """Open a stream of the unpacked voxels, at the first of them."""
    stored = header.stored
    with ExitStack() as opened:
        file = opened.enter_context(open_regular(stored.path))
        if stored.encoding == "raw":
            file.seek(_first_byte(header, file.seek(0, io.SEEK_END)))
            yield file
            return
        file.seek(stored.start or 0)
        stream = opened.enter_context(unpacked(file, stored))
        if len(stream.read(stored.skip)) < stored.skip:
            raise EOFError
        yield stream


def _first_byte(header: ImageHeader, size: int) -> int:
    """Return where raw voxels start; they must fill the file, else a forgotten header would shift them."""
    stored = header.stored
    needed = int(np.prod(header.shape, dtype=object)) * header.dtype.itemsize
    start = size - needed if stored.start is None else stored.start + stored.skip
    if start < 0 or start + needed > size:
        raise EOFError
    if start + needed < size:
        raise DamagedError(
            f"it holds {size - start} bytes of voxels, its header declares {needed}, so they may be shifted; "
            "convert it again"
        )
    return start


def unpacked(file: BinaryIO, stored: StoredVoxels) -> BinaryIO:
    """Return what is packed in ``file`` from its present position."""
    if stored.encoding == "raw":
        return file
    if stored.encoding == "bzip2":
        return cast("BinaryIO", bz2.BZ2File(file))
    return io.BufferedReader(_Inflated(file), _READ_AT_ONCE_BYTES)


class _Inflated(io.RawIOBase):
    """The inflated bytes of all zlib or gzip streams to the end of a file, each to its checksum.

    Python's own `gzip.GzipFile` reads in pieces of 8 KiB, which costs a third of the time.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._inflate = zlib.decompressobj(_ZLIB_OR_GZIP)

    def readable(self) -> bool:
        """Whether it can be read."""
        return True

    def readinto(self, target: Any) -> int:
        """Fill ``target``; return how many bytes there were, 0 at the end of a whole stream."""
        while True:
            if self._inflate.eof:
                packed = (self._inflate.unused_data or self._file.read(_READ_AT_ONCE_BYTES)).lstrip(b"\0")
                if not packed:
                    return 0
                self._inflate = zlib.decompressobj(_ZLIB_OR_GZIP)
            else:
                packed = self._inflate.unconsumed_tail or self._file.read(_READ_AT_ONCE_BYTES)
            content = self._inflate.decompress(packed, len(target))
            if content:
                target[: len(content)] = content
                return len(content)
            if not packed:
                raise EOFError
