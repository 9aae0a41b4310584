"""The pages are true: their code runs, they name what exists and what is written, and they build offline."""

import contextlib
import importlib
import importlib.util
import io
import itertools
import json
import re
import shlex
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import typer
from PIL import Image

import tspslam
from tspslam import cli
from tspslam.datasets import synthetic
from tspslam.io import _frame_schema as schema
from tspslam.io import read_vtu
from tspslam.run.config import resolve
from tspslam.run.pipeline import OnePair
from tspslam.run.pipeline import run as run_pipeline

from .patience import PATIENCE

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
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


def test_no_code_on_a_page_is_left_out():
    """Blocks that are set in, such as in a list, would be run by the build and not here."""
    counts = {path.stem: (path.read_text(encoding="utf-8").count(":: python\n"), len(code_of(path))) for path in PAGES}
    assert sum(found for found, _ in counts.values()) > 40
    assert not {name: both for name, both in counts.items() if both[0] != both[1]}


def readme():
    return (ROOT / "README.md").read_text(encoding="utf-8")


def test_code_in_the_readme_runs():
    text = readme()
    namespace = {"__name__": "__main__"}
    for number, block in enumerate(re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)):
        exec(compile(block, f"README.md, block {number}", "exec"), namespace)


def test_links_and_pictures_of_the_readme_are_there():
    links = re.findall(r"\]\(([^)]+)\)", readme())
    assert len(links) > 5
    assert not [link for link in links if "://" not in link and not (ROOT / link.partition("#")[0]).exists()]
    assert "make demo" in readme()
    assert "make test" in readme()


def test_the_first_picture_is_small():
    path = DOCS / "images" / "street.png"
    with Image.open(path) as picture:
        assert picture.width <= 1600
    assert path.stat().st_size < 400_000
    assert "images/street.png" in page("index")
    assert "docs/images/street.png" in readme()


def test_the_first_picture_can_be_drawn_again():
    found = importlib.util.spec_from_file_location("street", DOCS / "street.py")
    street = importlib.util.module_from_spec(found)
    found.loader.exec_module(street)
    walk = synthetic.SyntheticSequence(synthetic.corridor(1.0))
    with tspslam.Session(walk.rig) as session:
        for pair in walk:
            session.process(pair)
        session.finish()
        picture = street.draw(tspslam.build_map(session))
    assert picture.size == street.SIZE[::-1]
    assert len(picture.getcolors()) > 50


def command_lines():
    """What stands after ``$ tspslam`` on the pages and, set in, in the README: where, words."""
    for path in PAGES:
        for line in re.findall(r"^ +\$ tspslam (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE):
            yield f"{path.stem}: {line}", shlex.split(line, comments=True)
    for line in re.findall(r"^    tspslam (.*)$", readme(), re.MULTILINE):
        yield f"README: {line}", shlex.split(line, comments=True)


def test_commands_on_the_pages_are_those_of_the_program():
    settings = {row.name for row in tspslam.list_settings()}
    lines = list(command_lines())
    assert len(lines) > 40
    wrong = []
    for where, (first, *words) in lines:
        command = typer.main.get_command(cli.app).commands.get(first)
        if command is not None and hasattr(command, "commands"):
            command = command.commands.get(words.pop(0))
        if command is None:
            wrong.append(where)
            continue
        known = {name for option in command.params for name in option.opts}
        keys = [after.partition("=")[0] for word, after in itertools.pairwise(words) if word == "--set"]
        is_known = all(word in known for word in words if word.startswith("--")) and settings.issuperset(keys)
        wrong += [] if is_known else [where]
    assert not wrong


def warning_codes():
    """Codes of warnings that the source can give."""
    folder = Path(tspslam.__file__).parent
    files = sorted(path for room in ("run", "datasets") for path in (folder / room).glob("*.py"))
    text = "\n".join(path.read_text(encoding="utf-8") for path in files)
    return set(re.findall(r'"code": "(\w+)"', text)) | set(re.findall(r'^ +yield "(\w+)", ', text, re.MULTILINE))


def test_every_warning_is_on_the_page_of_troubles():
    """Each has a row of its own; a row is for a warning that there is."""
    rows = set(re.findall(r"^   \* - ``(\w+)``$", page("troubleshooting"), re.MULTILINE))
    assert {"few_points", "map", "mesh", "no_shared_edge", "tracking_lost"} <= warning_codes()
    assert rows == warning_codes()


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


def found_by_search(html):
    """Names of the package that the search field of the pages knows."""
    text = (html / "searchindex.js").read_text(encoding="utf-8")
    index = json.loads(text[text.index("{") : text.rindex("}") + 1])
    return {entry[-1].rpartition(".")[2] for entries in index["objects"].values() for entry in entries}


NO_SPHINX = any(importlib.util.find_spec(name) is None for name in ("sphinx", "furo"))


@pytest.mark.skipif(NO_SPHINX, reason="sphinx or furo is not installed: pip install '.[docs]'")
def test_pages_build_without_a_warning_and_load_nothing_from_elsewhere(tmp_path):
    """One page's code is run by the build: that of all pages is by `test_code_on_a_page_runs`."""
    html, ran = tmp_path / "html", "from_pair_to_response"
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "-D", f"run_code_of={ran}", "-d", tmp_path / "doctrees", DOCS, html],
        capture_output=True, encoding="utf-8", timeout=PATIENCE,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    pages = [path.read_text(encoding="utf-8") for path in html.glob("*.html")]
    assert len(pages) > len(PAGES)
    assert "output highlight-text" in (html / f"{ran}.html").read_text(encoding="utf-8")
    loaded = re.compile(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=\"(?:https?:)?//")
    assert not any(loaded.search(text) for text in pages)
    assert any("<math" in text for text in pages)
    styles = [path.read_text(encoding="utf-8") for path in html.rglob("*.css")]
    assert len(styles) > 2
    assert not any(re.search(r"(?:url\(|@import )[\"']?(?:https?:)?//", text) for text in styles)
    assert "tmahf" in found_by_search(html)


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
    assert {
        "tspslam.settings",
        "tspslam.run.pipeline",
        "tspslam.vision.slam.keyframes.map",
        "tspslam.topology.mahf",
    } <= set(places)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    for wrong in ("tspslam.nothing", "tspslam.vision.nothing", "tspslam.run.nothing"):
        above, _, last = wrong.rpartition(".")
        with pytest.raises(AttributeError, match=f"module '{above}' has no attribute 'nothing'"):
            getattr(importlib.import_module(above), last)


def test_rooms_that_are_asked_for_alone_stay_out_of_a_star():
    assert {"errors", "frame", "run", "session", "settings", "topology", "types", "vision"} <= set(dir(tspslam))
    assert not {"run", "session", "settings", "types"} & set(tspslam.__all__)
