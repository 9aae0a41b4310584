"""Whatever a name holds, a terminal gets text; whatever becomes of the streams, the exit code tells."""

import io
import json
import os
import re
import subprocess
import sys
import unicodedata

import numpy as np
import pytest

from tests.datasets import standard
from tests.test_cli import complain, run_pair, type_in
from tspslam import cli, printing
from tspslam.io import write_tum

EVIL = "a\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp\u200b\n[red]b[x]\x7f"
needs_any_name = pytest.mark.skipif(sys.platform == "win32", reason="such names cannot be there")


def is_text(printed):
    return all(line.isprintable() for line in printed.split("\n"))


def test_what_is_not_printable_is_escaped_and_all_else_stays():
    for code in range(0x3000):
        character = chr(code)
        shown = printing.escaped(character)
        assert shown.isprintable()
        assert (shown == character) == (unicodedata.category(character) not in ("Cc", "Cf", "Cn", "Zl", "Zp") and
                                        not (unicodedata.category(character) == "Zs" and character != " "))  # fmt: skip
    assert printing.escaped("\udcff\U000e0001") == "\\udcff\\U000e0001"
    assert printing.escaped("Straße 漢字 [bold] \\ 🙂") == "Straße 漢字 [bold] \\ 🙂"


def test_json_stays_json():
    assert json.loads(printing.escaped(json.dumps({EVIL: EVIL}))) == {EVIL: EVIL}
    assert is_text(printing.escaped(json.dumps(EVIL)))


@needs_any_name
def test_every_command_prints_names_escaped(capsys, pair_files):
    folder = pair_files / EVIL
    out = folder / "out"
    folder.mkdir()
    for name in ("left.png", "right.png", "calib.yaml"):
        (pair_files / name).rename(folder / name)
    code, printed, remarks = run_pair(capsys, folder)
    assert (code, is_text(printed + remarks), printed.count("\n")) == (0, True, 16)
    write_tum(folder / "t.tum", np.arange(20) / 10, standard.poses(20))
    for words, count in (
        (["filter", out / "map.ply", "--image", folder / "left.png", "--calib", folder / "calib.yaml", "--out", folder / "f"], 11),
        (["export", out, "--output", folder / "a.vtu"], 1),
        (["calib", "convert", folder / "calib.yaml", folder / "b.yaml"], 1),
        (["calib", "show", folder / "calib.yaml"], 10),
        (["eval", folder / "t.tum", "--truth", folder / "t.tum"], 19),
        (["config", "show", "--config", out / "config.yaml"], None),
    ):  # fmt: skip
        code, printed, remarks = type_in(capsys, *words)
        assert (code, is_text(printed + remarks)) == (0, True)
        assert count in (None, printed.count("\n"))
    code, printed, _ = type_in(capsys, "export", out, "--output", folder / "c.vtu", "--json")
    assert json.loads(printed) == {"written": str(folder / "c.vtu")}


@pytest.mark.parametrize("words", [
    ["run", EVIL], ["run", EVIL, EVIL, "--calib", EVIL], ["filter", EVIL, "--image", EVIL, "--calib", EVIL],
    ["export", EVIL], ["export", "x", "--to", EVIL], ["eval", EVIL, "--truth", EVIL], ["calib", "show", EVIL],
    ["calib", "convert", EVIL, EVIL], ["config", "show", "--set", EVIL], ["config", "show", "--config", EVIL],
    [EVIL], [f"--{EVIL}"], ["run", f"--{EVIL}"], ["run", "--detector", EVIL], ["run", "--frames", EVIL],
])  # fmt: skip
def test_every_error_is_one_line_of_text(capsys, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    code, line = complain(capsys, *words)
    assert code in (2, 3)
    assert line.isprintable()


def test_warnings_logs_and_tracebacks_go_the_same_way():
    script = (
        "import logging, warnings; from tspslam import printing; printing.listen()\n"
        f"evil = {EVIL!r}\n"
        "logging.getLogger('PIL').warning('a %s', evil); warnings.warn(evil); raise ValueError(evil)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, encoding="utf-8")
    assert done.returncode == 1
    assert is_text(done.stderr)
    assert done.stderr.count("owned") >= 3
    assert "Traceback" in done.stderr


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_line_is_renewed_below_what_is_noted_and_holds_nothing_that_a_terminal_would_obey(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    printing.renew(f"half {EVIL}")
    printing.note("a remark")
    printing.renew("all")
    printing.leave("")
    written = sys.stderr.getvalue()
    assert set(written) - {"\r", "\n"} == {each for each in written if each.isprintable()}
    assert shown_on_a_terminal(written)[:3] == ["a remark", "all", ""]


def test_a_line_is_cut_before_the_last_column(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setattr(printing, "columns", lambda: 20)
    printing.renew("x" * 100)
    printing.renew("short")
    printing.leave("done")
    assert max(map(len, re.split("[\r\n]", sys.stderr.getvalue()))) == 19
    assert shown_on_a_terminal(sys.stderr.getvalue()) == ["done", ""]


def shown_on_a_terminal(written):
    """Lines as they stand after all has been written, without spaces at their ends."""
    lines = []
    for line in written.replace("\r\n", "\n").split("\n"):
        shown = ""
        for part in line.split("\r"):
            shown = part + shown[len(part) :]
        lines.append(shown.rstrip())
    return lines


def test_remarks_for_programs_are_objects(capsys):
    with printing.remarks_as_json():
        printing.note(EVIL, "warning: a: b", "note: c")
    printing.note("plain")
    lines = capsys.readouterr().err.splitlines()
    assert [json.loads(line) for line in lines[:3]] == [{"note": EVIL}, {"warning": "a: b"}, {"note": "c"}]
    assert lines[3:] == ["plain"]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot tell whether a pipe has room")
def test_a_reader_who_does_not_read_holds_nothing_up(monkeypatch):
    reader, writer = os.pipe()
    with open(reader, encoding="utf-8") as ours, open(writer, "w", encoding="utf-8") as theirs:
        monkeypatch.setattr(sys, "stderr", theirs)
        for k in range(20_000):  # over a megabyte, far more than a pipe holds
            printing.note_json({"stage": "tracking", "done": k, "total": 10**9, "left_s": None})
        theirs.close()
        kept = [json.loads(line)["done"] for line in ours]
    assert kept == list(range(len(kept)))
    assert 10 < len(kept) < 20_000


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_names_that_the_stream_cannot_hold_are_escaped(tmp_path, encoding):
    (tmp_path / "漢é.txt").write_text("P0: 50 0 10 0 0 50 5 0 0 0 1 0\nP1: 50 0 10 -5 0 50 5 0 0 0 1 0\n")
    command = [sys.executable, "-m", "tspslam", "calib", "show", str(tmp_path / "漢é.txt"), "--size", "20x10"]
    done = subprocess.run(command, capture_output=True, env=os.environ | {"PYTHONIOENCODING": encoding})
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"\\u6f22" in done.stdout


COMMANDS = [["--version"], ["--help"], ["run", "--help"], ["config", "show"]]


@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")
@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_a_closed_a_full_and_an_unwritable_stdout_is_code_5_and_one_line(words):
    line = f"{sys.executable} -m tspslam {' '.join(words)}"
    said = {">&-": "is closed; expected an open one", "1</dev/null": "cannot be written"}
    if os.path.exists("/dev/full"):
        said[">/dev/full"] = "cannot be written"
    for stream, reason in said.items():
        done = subprocess.run(["bash", "-c", f"{line} {stream}"], capture_output=True, text=True)
        assert done.returncode == 5, stream
        assert done.stderr.startswith(f"tspslam: standard output: {reason}")
        assert done.stderr.count("\n") == 1
    assert subprocess.run(["bash", "-c", f"{line} >&- 2>&-"], capture_output=True).returncode == 5


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_a_reader_who_has_gone_away_hears_no_more_and_it_is_no_failure(words):
    gone, end = os.pipe()
    os.close(gone)
    done = subprocess.run([sys.executable, "-m", "tspslam", *words], stdout=end, stderr=subprocess.PIPE)
    os.close(end)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")
def test_no_file_takes_the_number_of_a_closed_stream():
    script = "from tspslam import printing; import os; printing.hold_streams(); print(os.open(os.devnull, 0) > 2)"
    line = f"{sys.executable} -c '{script}' <&- 2>&-"
    assert subprocess.run(["bash", "-c", line], capture_output=True, text=True).stdout == "True\n"


def test_without_words_the_help_is_shown(capsys):
    _, out, err = type_in(capsys)
    assert "Commands:" in out + err
    assert cli.exit_code(["--help"]) == 0
    assert capsys.readouterr().out.startswith("Usage: tspslam")
