"""Bags that say more than they hold, or hold more than they say, are refused before memory is taken for it."""

import bz2
import contextlib
import importlib
import io
import sqlite3
import struct
import tracemalloc

import pytest

pytest.importorskip("rosbags")
import lz4.frame

from tspslam.datasets import RosbagSequence, _bags, _containers

from .test_rosbag import COUNT, KINDS, LEFT, drive, one_line_error, pairs, write  # noqa: F401 (a fixture)

MEGA = 1 << 20
LARGE = 64 * MEGA  # bytes, unpacked
MOST = 16 * MEGA  # bytes that a refusal may take


def zstd(data):
    for name in ("compression.zstd", "backports.zstd", "zstandard"):
        with contextlib.suppress(ImportError):
            return importlib.import_module(name).compress(data)
    raise AssertionError("no zstd")


PACK = {"bz2": bz2.compress, "lz4": lz4.frame.compress, "zstd": zstd}


def record(data=b"", **fields):
    """A record of ROS 1."""
    values = {name: value if isinstance(value, bytes) else struct.pack("<I", value) for name, value in fields.items()}
    values = {name: struct.pack("<Q", fields[name]) if name.endswith("_pos") else v for name, v in values.items()}
    values["op"] = bytes([fields["op"]])
    header = b"".join(struct.pack("<I", len(n) + 1 + len(v)) + n.encode() + b"=" + v for n, v in values.items())
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def bag1(
    path, content=b"x" * 100, kind="none", *, said=None, offsets=(0,), infos=1, lists=1, shift=0, index=None,
    counted=None, text=b"d", topic=b"/a",
):  # fmt: skip
    """A bag of ROS 1 with one chunk, one connection and their index, each of which may be wrong."""
    packed = PACK[kind](content) if kind != "none" else content
    counted = infos if counted is None else counted
    before = b"#ROSBAG V2.0\n" + record(op=3, index_pos=0, conn_count=1, chunk_count=counted)
    chunk = record(packed, op=5, compression=kind.encode(), size=len(content) if said is None else said)
    table = record(b"".join(struct.pack("<QI", 5, each) for each in offsets), op=4, ver=1, conn=0, count=len(offsets))
    end = len(before) + len(chunk) + len(table)
    told = {"type": b"a/B", "md5sum": b"0", "message_definition": text}
    link = b"".join(struct.pack("<I", len(n) + 1 + len(v)) + n.encode() + b"=" + v for n, v in told.items())
    info = record(
        struct.pack("<II", 0, len(offsets)) * lists, op=6, ver=1, chunk_pos=len(before) + shift,
        start_time=bytes(8), end_time=bytes(8), count=lists,
    )  # fmt: skip
    first = record(op=3, index_pos=end if index is None else index, conn_count=1, chunk_count=counted)
    path.write_bytes(b"#ROSBAG V2.0\n" + first + chunk + table + record(link, op=7, conn=0, topic=topic) + info * infos)
    return path


def mcap_record(operation, data):
    return bytes([operation]) + struct.pack("<Q", len(data)) + data


def text(word):
    return struct.pack("<I", len(word)) + word.encode()


def mcap(path, content=b"", kind="", *, said=None, listed=1, shift=0, told=None, cut=0, summary=0):
    """An MCAP file with one chunk, listed in its index so many times."""
    packed = PACK[kind](content) if kind else content
    size = len(content) if said is None else said
    body = struct.pack("<QQQI", 0, 9, size, 0) + text(kind) + struct.pack("<Q", len(packed)) + packed
    head = b"\x89MCAP0\r\n" + mcap_record(1, text("ros2") + text(""))
    at = len(head) + shift
    index = struct.pack("<QQQQI", 0, 9, at, len(body) + 9, 0) + struct.pack("<Q", 0) + text(kind)
    index += struct.pack("<QQ", len(packed), size if told is None else told)
    data = head + mcap_record(6, body)
    begin = len(data) + summary
    data += mcap_record(8, index) * listed + mcap_record(2, struct.pack("<QQI", begin, 0, 0)) + b"\x89MCAP0\r\n"
    path.write_bytes(data[: len(data) - cut])
    return path


def refusal(path, wanted):
    """Refuse a bag in one line, and without memory."""
    tracemalloc.start()
    line = one_line_error(lambda: RosbagSequence(path), wanted)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert line.startswith(f"{path}: cannot be read (")
    assert peak < MOST
    return line


@pytest.mark.parametrize("kind", ["bz2", "lz4"])
@pytest.mark.parametrize(
    ("said", "wanted"), [(1000, "1000 bytes, and has more"), (1 << 30, "that it holds 1073741824")]
)
def test_a_chunk_of_ros_1_is_as_large_as_it_says_and_bearable(tmp_path, kind, said, wanted):
    refusal(bag1(tmp_path / "a.bag", bytes(LARGE), kind, said=said), wanted)


@pytest.mark.parametrize("kind", ["lz4", "zstd"])
@pytest.mark.parametrize(
    ("said", "wanted"), [(1000, "1000 bytes, and has more"), (1 << 40, "that it holds 1099511627776")]
)
def test_a_chunk_of_mcap_is_as_large_as_it_says_and_bearable(tmp_path, kind, said, wanted):
    refusal(mcap(tmp_path / "a.mcap", bytes(LARGE), kind, said=said), wanted)


@pytest.mark.parametrize("kind", PACK)
def test_several_frames_are_counted_together(kind):
    with _containers.unpacked(kind, io.BytesIO(PACK[kind](bytes(MEGA)) * 3)) as content:
        assert len(content.read(4 * MEGA)) == 3 * MEGA


BAD_ROS1 = {
    "an index leads out of its chunk": {"offsets": (0, 100)},
    "an index leads to one message twice": {"offsets": (7, 7)},
    "of no chunk, or of one twice": {"infos": 2},
    "is of no chunk": {"shift": 4},
    "or of other topics than it has": {"lists": 3},
    "its index is not at byte": {"infos": 0, "counted": 1},
    "is not where the bag says": {"index": 13},
    "it has no index, as it was not closed": {"index": 0},
    "a chunk of 100 bytes says that it holds 5": {"said": 5},
    "the connection at byte": {"text": b"uint8 x\n" * 200_000},
    "a chunk says that it holds 900 bytes, and has 100": {"said": 900, "kind": "bz2"},
}


@pytest.mark.parametrize("wanted", BAD_ROS1)
def test_an_index_of_ros_1_leads_to_what_is_there(tmp_path, wanted):
    path = bag1(tmp_path / "a.bag", **BAD_ROS1[wanted])
    refusal(path, wanted)


@pytest.mark.parametrize("topic", [b"", b"\xff", b"/\x1b[31m\nred", b"/" + b"a" * 100_000])
def test_a_hostile_topic_gets_one_line(tmp_path, topic):
    line = one_line_error(lambda: RosbagSequence(bag1(tmp_path / "a.bag", topic=topic)), "a.bag: ")
    assert line.isprintable()
    assert len(line) < 1000


def test_sizes_behind_the_end_are_refused(tmp_path):
    path = bag1(tmp_path / "a.bag")
    whole = path.read_bytes()
    at = whole.index(b"compression=none")
    for place in (13, at - 8, whole.rindex(b"ver=") - 8):
        data = bytearray(whole)
        data[place : place + 4] = b"\xff\xff\xff\x7f"
        path.write_bytes(bytes(data))
        assert "cannot be read (" in refusal(path, "the record at byte ")


BAD_MCAP = {
    "where there is none of this size": {"shift": 8},
    "its index has a chunk at byte": {"told": 7},
    "it does not end as MCAP": {"cut": 3},
    "its summary is not at byte": {"summary": 5},
    "a chunk is packed by 'zip'": {"kind": "zip"},
}


@pytest.mark.parametrize("wanted", BAD_MCAP)
def test_an_index_of_mcap_leads_to_what_is_there(tmp_path, wanted, monkeypatch):
    monkeypatch.setitem(PACK, "zip", bytes)
    refusal(mcap(tmp_path / "a.mcap", b"x" * 50, **BAD_MCAP[wanted]), wanted)


def test_chunks_of_one_moment_are_bearable_together(tmp_path):
    """A chunk that is listed again and again would be unpacked as often, all at once."""
    refusal(
        mcap(tmp_path / "a.mcap", bytes(LARGE), "zstd", listed=9), "chunks of one moment hold 603979776 bytes together"
    )
    one = _containers._Listed
    _containers._check_together([one(k, k + 1, 0, "", 0, 1 << 28) for k in range(0, 90, 3)])  # one after another


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (
            "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS SELECT * FROM m",
            "its messages is a view, no table",
        ),
        (
            "ALTER TABLE messages ADD COLUMN d BLOB AS (zeroblob(1000000000))",
            "its table messages has a column that is made",
        ),
        ("CREATE TRIGGER t AFTER INSERT ON topics BEGIN SELECT 1; END", "its t is a trigger"),
        ("CREATE VIRTUAL TABLE v USING fts5(x)", "its table v is a virtual one"),
    ],
)
def test_a_database_of_more_than_tables_is_refused(tmp_path, pairs, change, wanted):  # noqa: F811
    ros = KINDS["sqlite3"]
    path = write(tmp_path / "drive", ros, drive(ros, pairs))
    with contextlib.closing(sqlite3.connect(path / "drive.db3")) as base:
        try:
            base.executescript(change)
        except sqlite3.OperationalError as error:
            pytest.skip(f"this sqlite has no such thing ({error})")
    refusal(path, wanted)


def test_a_packed_file_or_message_is_unpacked_no_further_than_is_bearable(tmp_path, pairs, monkeypatch):  # noqa: F811
    monkeypatch.setattr(_bags, "LARGEST_CHUNK", MEGA)
    monkeypatch.setattr(_containers, "LARGEST_CHUNK", MEGA)
    for kind in ("sqlite3-zstd", "sqlite3-message"):
        ros = KINDS[kind]
        path = write(tmp_path / kind, ros, drive(ros, pairs))
        assert len(RosbagSequence(path)) == COUNT
        if kind == "sqlite3-zstd":
            (path / f"{kind}.db3.zstd").write_bytes(zstd(bytes(LARGE)))
            refusal(path, f"{kind}.db3.zstd unpacks to more than 1048576 bytes")
            continue
        with contextlib.closing(sqlite3.connect(path / f"{kind}.db3")) as base, base:
            base.execute("UPDATE messages SET data = ?", (zstd(bytes(LARGE)),))
        refusal(path, "bytes unpack to more than 1048576")


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_messages_are_understood_as_ros_defines_them_whatever_the_bag_says(tmp_path, pairs, kind):  # noqa: F811
    ros = KINDS[kind]
    path = write(tmp_path / ros.name, ros, drive(ros, pairs))
    file = path if path.is_file() else path / "drive.mcap"
    whole = file.read_bytes()
    assert whole.count(b"uint8[] data") + whole.count(b"sequence<uint8> data") > 0
    file.write_bytes(
        whole.replace(b"uint8[] data", b"Empty[] junk").replace(b"sequence<uint8> data", b"sequence<Empty> junk")
    )
    sequence = RosbagSequence(path)
    assert sequence.topics[0] == LEFT
    assert sequence[1].left.tobytes() == pairs[1].left.tobytes()
