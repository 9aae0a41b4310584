"""Bags of ROS as topics and messages: each file is checked, then opened by rosbags."""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
import weakref
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path, PurePath
from typing import Any

from .._files import bad_input, open_input, reason_of
from ..errors import InputError
from ..vision.calibration.formats._opencv_yaml import read_mapping
from ._containers import LARGEST_CHUNK, check_mcap, check_ros1, check_sqlite, unpacked, unpacked_bytes

BAG = "a whole bag of ROS 1 (.bag) or ROS 2 (a folder with metadata.yaml, .mcap, .db3)"
_LARGEST_BAG = 1 << 50  # bytes
_MISSING = "the library rosbags: pip install tspslam[ros]"
_METADATA = "a metadata.yaml of rosbag2 that lists files"
_DENSEST = 100  # bytes unpacked for one of a packed file: recordings of images have 1 to 10
_PIECE = 1 << 20  # bytes
Messages = Generator[tuple[str, int, Any], None, None]


class Bag:
    """An open bag: the topics of some types that have messages, and these one by one, for one thread at a time.

    Messages are understood by the definitions of ROS itself, never by those that a bag brings along.
    """

    def __init__(self, path: Path, types: Sequence[str]) -> None:
        self.path, self.is2 = path, path.suffix.lower() != ".bag"
        self._lock = threading.Lock()
        self._others: set[str] = set()
        with contextlib.ExitStack() as stack:
            self._store, readers, self._is_packed = _opened(path, stack)
            weakref.finalize(self, stack.pop_all().close)
        self._links: list[tuple[Any, list[Any]]] = []  # of each file, its reader and connections
        for reader in readers:
            used = [each for each in reader.connections if each.msgtype in types and each.msgcount]
            self._links.append((reader, used))
            rest = [each for each in reader.connections if each not in used]
            self._others |= {f"{each.topic} ({each.msgtype if each.msgcount else 'no message'})" for each in rest}

    @property
    def kinds(self) -> dict[str, str]:
        """Type of the messages of each topic."""
        return {each.topic: each.msgtype for _, links in reversed(self._links) for each in reversed(links)}

    @property
    def others(self) -> list[str]:
        """Topics of other types, or without messages, with the type."""
        return sorted(self._others)

    @contextlib.contextmanager
    def messages(self, topics: Sequence[str], start: int | None = None, stop: int | None = None) -> Iterator[Messages]:
        """Topic, time of recording (ns) and bytes of the messages recorded from `start` to before `stop`."""
        found = self._messages(topics, start, stop)
        with self._lock, guarded(self.path), contextlib.closing(found):  # an open cursor would keep the file open
            yield found

    def _messages(self, topics: Sequence[str], start: int | None, stop: int | None) -> Messages:
        for reader, links in self._links:
            wanted = [each for each in links if each.topic in topics]
            if not wanted:
                continue
            with contextlib.closing(reader.messages(wanted, start, stop)) as found:
                for link, time, data in found:
                    yield link.topic, time, unpacked_bytes("zstd", data) if self._is_packed else data

    def deserialize(self, data: Any, kind: str) -> Any:
        """Return the message that bytes hold."""
        with guarded(self.path):
            return self._store.deserialize_cdr(data, kind) if self.is2 else self._store.deserialize_ros1(data, kind)


@contextlib.contextmanager
def guarded(path: Path) -> Iterator[None]:
    """Turn what rosbags, and the libraries below it, raise at damaged bags (anything) into an InputError."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise bad_input(path, f"cannot be read ({reason_of(error)})", BAG) from error


def _opened(path: Path, stack: contextlib.ExitStack) -> tuple[Any, list[Any], bool]:
    """Definitions of messages, readers of the bag's files, and whether each message is packed."""
    files, mode = _files_of(path)
    for file in files:
        open_input(file, BAG, _LARGEST_BAG).close()
    try:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise bad_input(path, f"cannot be read ({reason_of(error)})", _MISSING) from error
    with guarded(path):
        if mode == "file":
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            files = [_unpack(file, folder / file.stem) for file in files]
        is1 = path.suffix.lower() == ".bag"
        readers = [_checked(file, rosbag1 if is1 else rosbag2, stack) for file in files]
        store = get_typestore(Stores.ROS1_NOETIC if is1 else Stores.ROS2_HUMBLE)
    return store, readers, mode == "message"


def _files_of(path: Path) -> tuple[list[Path], str]:
    """Files of a bag in the order of time, and what of them is packed: nothing, "file" or "message"."""
    if not os.path.isdir(path):
        return [path], ""
    metadata = path / "metadata.yaml"
    found = read_mapping(metadata, _METADATA).get("rosbag2_bagfile_information")
    names = found.get("relative_file_paths") if isinstance(found, dict) else None
    if not isinstance(found, dict) or not isinstance(names, list) or not names:
        raise bad_input(metadata, "lists no files (rosbag2_bagfile_information: relative_file_paths)", _METADATA)
    mode = str(found.get("compression_mode") or "none").lower()
    if mode not in ("none", "file", "message", "storage") or (mode in ("file", "message") and _packer(found) != "zstd"):
        raise bad_input(metadata, f"says that {mode[:20]} is packed by {_packer(found)}", "file or message, by zstd")
    files = [path / PurePath(str(name)).name for name in names]
    if len(set(files)) < len(files):
        raise bad_input(metadata, "lists a file twice", _METADATA)
    return files, mode


def _packer(found: dict[Any, Any]) -> str:
    return str(found.get("compression_format"))[:20]


def _unpack(file: Path, target: Path) -> Path:
    """Unpack a file piece by piece, unless it is far larger then."""
    most = max(LARGEST_CHUNK, _DENSEST * os.stat(file).st_size)
    total = 0
    with open_input(file, BAG, _LARGEST_BAG) as packed, unpacked("zstd", packed) as content, open(target, "wb") as out:
        while piece := content.read(_PIECE):
            total += len(piece)
            if total > most:
                raise ValueError(f"{file.name} unpacks to more than {most} bytes")
            out.write(piece)
    return target


def _checked(file: Path, library: Any, stack: contextlib.ExitStack) -> Any:
    """Open a file whose records are what they say."""
    kind = file.suffix.lower()
    with open_input(file, BAG, _LARGEST_BAG) as handle:
        size = os.fstat(handle.fileno()).st_size
        if kind == ".bag":
            check_ros1(handle, size)
        elif kind == ".mcap":
            check_mcap(handle, size)
        elif kind == ".db3":
            check_sqlite(file)
        else:
            raise ValueError(f"{file.name} is no .bag, .mcap or .db3")
    reader = library.Reader(file)
    reader.open()
    stack.callback(reader.close)
    return reader
