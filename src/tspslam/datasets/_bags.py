"""Bags of ROS as topics and messages: each file is checked, then opened by rosbags."""

from __future__ import annotations

import contextlib
import heapq
import os
import re
import tempfile
import threading
import weakref
from collections.abc import Generator, Iterator, Sequence
from operator import itemgetter
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
_PIECE_OF = re.compile(r".*_([0-9]{1,6})")  # name of a piece, as rosbag record --split numbers them
_LONGEST_GAP = 60 * 10**9  # ns between pieces of a recording, as between its frames
Messages = Generator[tuple[str, int, Any], None, None]


class Bag:
    """An open bag: the topics of some types that have messages, and these one by one, for one thread at a time.

    Messages are understood by the definitions of ROS itself, never by those that a bag brings along. Several files, and
    a folder of them, are the pieces of one recording; messages come in the order of time.
    """

    def __init__(self, path: Path | Sequence[Path], types: Sequence[str]) -> None:
        paths = [path] if isinstance(path, Path) else list(path)
        self.path = paths[0]
        self._lock = threading.Lock()
        self._others: set[str] = set()
        with contextlib.ExitStack() as stack:
            self._store, readers, self._is_packed, self.is2 = _opened(paths, stack)
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
        chosen = [(reader, [each for each in links if each.topic in topics]) for reader, links in self._links]
        with contextlib.ExitStack() as stack:
            found = [
                stack.enter_context(contextlib.closing(reader.messages(wanted, start, stop)))
                for reader, wanted in chosen
                if wanted
            ]
            for link, time, data in heapq.merge(*found, key=itemgetter(1)):
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


def _opened(paths: Sequence[Path], stack: contextlib.ExitStack) -> tuple[Any, list[Any], bool, bool]:
    """Definitions of messages, readers of the bag's files, whether each message is packed, and whether it is ROS 2."""
    path = paths[0]
    files, mode = _files_of(path) if len(paths) == 1 else (_alike(paths), "")
    for file in files:
        open_input(file, BAG, _LARGEST_BAG).close()
    try:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise bad_input(path, f"cannot be read ({reason_of(error)})", _MISSING) from error
    is1, readers = files[0].suffix.lower() == ".bag", []
    for file in files:
        with guarded(file if len(files) > 1 else path):
            if mode == "file":
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
                file = _unpack(file, folder / file.stem)
            readers.append(_checked(file, rosbag1 if is1 else rosbag2, stack))
    with guarded(path):
        store = get_typestore(Stores.ROS1_NOETIC if is1 else Stores.ROS2_HUMBLE)
        _check_gaps(path, [(reader.start_time, reader.end_time) for reader in readers if reader.message_count])
    return store, readers, mode == "message", not is1


def _alike(files: Sequence[Path]) -> list[Path]:
    """Files that are given as the pieces of one recording, if they are of one kind."""
    for file in files:
        if os.path.isdir(file):
            raise bad_input(
                file, "is a folder beside files of a bag", "the files of one recording, or its folder alone"
            )
    kinds = sorted({file.suffix.lower() for file in files})
    if len(kinds) > 1:
        raise bad_input(files[0], f"is given with files of other kinds ({', '.join(kinds)})", "pieces of one bag")
    if len(set(files)) < len(files):
        raise bad_input(files[0], "and its pieces hold a file twice", "each piece once")
    return list(files)


def pieces_in(folder: Path) -> list[Path]:
    """Files of ROS 1 in a folder, if it has any: one, or the pieces ``NAME_0.bag NAME_1.bag ...`` of one recording."""
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() == ".bag" and not file.name.startswith("."))
    numbers = [_PIECE_OF.fullmatch(file.stem) for file in files]
    found = sorted(int(number[1]) for number in numbers if number)
    if len(files) > 1 and found != list(range(found[0] if found else 0, (found[0] if found else 0) + len(files))):
        said = f"holds {len(files)} bags that are not the pieces of one recording, such as {files[0].name[:80]}"
        raise bad_input(folder, said, "NAME_0.bag NAME_1.bag ... without a gap, or the files that belong together")
    return files


def _check_gaps(path: Path, spans: Sequence[tuple[int, int]]) -> None:
    """Refuse pieces (ns from, to) between which there is more time than between frames: they are two recordings."""
    end = None
    for start, stop in sorted(spans):
        if end is not None and start - end > _LONGEST_GAP:
            said = f"and its pieces have a gap of {(start - end) / 1e9:.3g} s"
            raise bad_input(path, said, f"pieces of one recording, at most {_LONGEST_GAP // 10**9} s apart")
        end = max(stop, end or stop)


def _files_of(path: Path) -> tuple[list[Path], str]:
    """Files of a bag in the order of time, and what of them is packed: nothing, "file" or "message"."""
    if not os.path.isdir(path):
        return [path], ""
    metadata = path / "metadata.yaml"
    pieces = [] if metadata.exists() else pieces_in(path)
    if pieces:
        return pieces, ""
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
