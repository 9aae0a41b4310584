"""The pages are true: their code runs, they name what exists and what is written, and they build offline."""

import contextlib
import importlib
import importlib.util
import io
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import typer

import tspslam
from tspslam import cli
from tspslam.io import _frame_schema as schema
from tspslam.io import read_vtu
from tspslam.run.config import resolve
from tspslam.run.pipeline import OnePair
from tspslam.run.pipeline import run as run_pipeline

DOCS = Path(__file__).parents[1] / "docs"
PAGES = sorted(DOCS.glob("*.rst"))
BLOCK = re.compile(r"^\.\. code-block:: python\n\n((?: {3,}.*\n|\n)+)", re.MULTILINE)


def page(name):
    return (DOCS / f"{name}.rst").read_text(encoding="utf-8")


def code_of(path):
    return [textwrap.dedent(block) for block in BLOCK.findall(path.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("path", [path for path in PAGES if code_of(path)], ids=lambda path: path.stem)
def test_code_on_a_page_runs(path):
    namespace = {"__name__": "__main__"}
    for number, block in enumerate(code_of(path)):
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(block, f"{path.name}, block {number}", "exec"), namespace)


def test_code_in_the_readme_runs():
    text = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    namespace = {"__name__": "__main__"}
    for number, block in enumerate(re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)):
        exec(compile(block, f"README.md, block {number}", "exec"), namespace)


def test_code_fits_the_column():
    assert [line for path in PAGES for block in code_of(path) for line in block.splitlines() if len(line) > 88] == []


def test_tables_in_plain_text_fit_the_column():
    blocks = re.compile(r"^\.\. code-block:: (?:text|yaml|console)\n\n((?: {3,}.*\n|\n)+)", re.MULTILINE)
    lines = [line for path in PAGES for block in blocks.findall(path.read_text("utf-8")) for line in block.splitlines()]
    assert len(lines) > 50
    assert [line for line in lines if len(line) > 3 + 88] == []


def test_centring_by_hand_agrees_with_the_filter():
    printed = io.StringIO()
    namespace = {"__name__": "__main__"}
    with contextlib.redirect_stdout(printed):
        for block in code_of(DOCS / "from_pair_to_response.rst"):
            exec(block, namespace)
    responses = re.findall(r"r = (\S+j)", printed.getvalue())
    assert len(responses) == 4
    assert responses[0] == responses[1]
    assert responses[2] == responses[3]


def test_every_public_name_is_on_the_api_page():
    text = page("api")
    rooms = {"datasets", "io", "view"}
    missing = [name for name in tspslam.__all__ if name not in rooms and f":: tspslam.{name}\n" not in text]
    assert not missing
    assert all(f":: tspslam.{room}\n" in text for room in rooms)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, small_pair):
    left, right, rig = small_pair
    out = tmp_path_factory.mktemp("run") / "run"
    run_pipeline(OnePair(tspslam.StereoPair(left, right, rig)), out, resolve())
    return out


def unnamed(names, text):
    """Which of the names do not stand in double backticks on the page."""
    return sorted(name for name in names if not re.search(rf"``[^`]*\b{re.escape(name)}\b[^`]*``", text))


def test_every_file_of_a_run_is_on_the_outputs_page(folder):
    files = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".")]
    names = [path.stem if path.parent.name == "pictures" else path.as_posix() for path in files]
    assert not unnamed([name for name in names if not name.startswith("trajectory")], page("outputs"))
    assert {"trajectory.tum", "trajectory.kitti.txt"} <= set(names)


def test_every_key_of_run_json_is_on_the_outputs_page(folder):
    import json

    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    keys = {*record, *record["complex"], *record["calibration"], *record["per_frame"][0]}
    assert not unnamed(keys, page("outputs"))


def test_every_array_of_a_frame_and_of_the_map_is_on_the_outputs_page(folder):
    mesh = read_vtu(folder / "map.vtu")
    assert not unnamed([*schema.SCHEMA, *mesh.point_data, *mesh.cell_data], page("outputs"))


def test_every_command_and_exit_code_is_on_the_outputs_page():
    text = page("outputs")
    group = typer.main.get_command(cli.app)
    assert not [name for name in group.commands if f"$ tspslam {name}" not in text]
    codes = {cli.COMPLETE, cli.INTERNAL, cli.USAGE, cli.BAD_INPUT, cli.DEGRADED, cli.NOT_WRITTEN, cli.INTERRUPTED}
    exits = text.partition("Exit codes\n")[2].partition("The run folder\n")[0]
    assert {int(code) for code in re.findall(r"^   \* - (\d+)$", exits, re.MULTILINE)} == codes


@pytest.mark.skipif(importlib.util.find_spec("sphinx") is None, reason="sphinx is not installed: pip install '.[docs]'")
def test_pages_build_without_a_warning_and_load_nothing_from_elsewhere(tmp_path):
    html = tmp_path / "html"
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", "-d", tmp_path / "doctrees", DOCS, html],
        capture_output=True, encoding="utf-8", timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    pages = [path.read_text(encoding="utf-8") for path in html.glob("*.html")]
    assert len(pages) > len(PAGES)
    loaded = re.compile(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=\"(?:https?:)?//")
    assert not any(loaded.search(text) for text in pages)
    assert any("<math" in text for text in pages)


def test_names_of_the_api_page_are_there_after_a_plain_import():
    """Each place in a package that is new but for the libraries below it: none is there since another was asked for."""
    names = re.findall(r":: (tspslam\.[\w.]+)$", page("api"), re.MULTILINE)
    places = {name.rpartition(".")[0]: name for name in names}
    code = (
        "import operator, sys\n"
        f"for name in {sorted(places.values())}:\n"
        "    for old in [each for each in sys.modules if each.split('.')[0] == 'tspslam']: del sys.modules[old]\n"
        "    import tspslam\n"
        "    operator.attrgetter(name.partition('.')[2])(tspslam)\n"
    )
    assert {"tspslam.settings", "tspslam.run.pipeline", "tspslam.vision.slam.map", "tspslam.topology.mahf"} <= set(
        places
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    for wrong in ("tspslam.nothing", "tspslam.vision.nothing", "tspslam.run.nothing"):
        above, _, last = wrong.rpartition(".")
        with pytest.raises(AttributeError, match=f"module '{above}' has no attribute 'nothing'"):
            getattr(importlib.import_module(above), last)


def test_rooms_that_are_asked_for_alone_stay_out_of_a_star():
    assert {"errors", "frame", "run", "session", "settings", "topology", "types", "vision"} <= set(dir(tspslam))
    assert not {"run", "session", "settings", "types"} & set(tspslam.__all__)
