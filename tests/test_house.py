"""The house keeps its shape: arrows point down, the wings never meet, functions stay short."""

import ast
import re
import statistics
import tomllib
from pathlib import Path

import tspslam

SRC = Path(tspslam.__file__).parent
GROUND = {
    "_atomic",
    "_checks",
    "_files",
    "_jit",
    "_npz",
    "_settings",
    "_stopwatch",
    "_text",
    "_yaml",
    "types",
    "errors",
}
BELOW = {  # what each room may import, besides itself: docs/architecture.rst draws it
    "__main__": {"cli"},
    "cli": {"run", "view", "session", "frame", "interop", "datasets", "io", "vision", "topology", "printing"} | GROUND,
    "run": {"session", "frame", "interop", "datasets", "io", "view", "vision", "topology"} | GROUND,
    "interop": {"datasets", "io", "frame", "vision", "topology"} | GROUND,
    "session": {"frame", "vision", "topology"} | GROUND,
    "datasets": {"vision", "io"} | GROUND,
    "io": {"frame", "topology"} | GROUND,
    "view": {"frame", "topology"} | GROUND,
    "frame": {"vision", "topology"} | GROUND,
    "vision": GROUND,
    "topology": GROUND,
    "printing": {"errors"},
    "_atomic": {"_files", "errors"},
    "_files": {"_checks", "errors"},
    "_npz": {"_files", "errors"},
    "_text": {"_files"},
    "_yaml": {"_files", "_text"},
    "types": {"_checks", "errors"},
    "_checks": {"errors"},
    "_jit": set(),
    "_settings": {"errors"},
    "_stopwatch": set(),
    "errors": set(),
}
SHARED = {"rig", "se3", "images", "_parallel"}  # files of `vision` that all of its rooms stand on
BELOW_IN_VISION = {
    "slam": {"stereo", "features"} | SHARED,
    "stereo": {"features"} | SHARED,
    "features": SHARED,
    "calibration": SHARED,
    "visibility": {"_visibility"} | SHARED,
    "evaluate": {"se3"},
    "_visibility": set(),
    "rig": set(),
    "se3": set(),
    "images": set(),
    "_parallel": set(),
}
MAX_FILES = 12  # in a folder of `vision`
FILES = {path.relative_to(SRC).with_suffix("").as_posix(): ast.parse(path.read_text()) for path in SRC.rglob("*.py")}


def imports_of(name: str) -> set[str]:
    """Modules of the package that a file imports, as paths below the package."""
    folder = name.split("/")[:-1]
    found = set()
    for node in ast.walk(FILES[name]):
        if not isinstance(node, ast.ImportFrom) or not (node.level or (node.module or "").startswith("tspslam")):
            continue
        base = folder[: len(folder) + 1 - node.level] if node.level else []
        inner = (node.module or "").removeprefix("tspslam").strip(".")
        module = [*base, *([part for part in inner.split(".") if part])]
        for alias in node.names:
            target = "/".join([*module, alias.name])
            found.add(target if target in FILES or f"{target}/__init__" in FILES else "/".join(module))
    return {target for target in found if target}


def test_arrows_point_down_and_the_wings_never_meet():
    wrong = [
        f"{name} -> {target}"
        for name in FILES
        if name != "__init__"
        for target in imports_of(name)
        if (room := name.split("/")[0]) != (other := target.split("/")[0]) and other not in BELOW[room]
    ]
    assert not wrong


def test_rooms_of_vision_point_down_too():
    wrong = [
        f"{name} -> {target}"
        for name in FILES
        if name.startswith("vision/") and name != "vision/__init__"
        for target in imports_of(name)
        if target.startswith("vision/")
        and (room := name.split("/")[1]) != (other := target.split("/")[1])
        and other not in BELOW_IN_VISION[room]
    ]
    assert not wrong


def test_no_folder_of_vision_is_crowded():
    folders = [SRC / "vision", *(path for path in (SRC / "vision").rglob("*") if path.is_dir())]
    assert max(len(list(folder.glob("*.py"))) for folder in folders) <= MAX_FILES


def test_imports_have_no_cycle():
    graph = {
        name: {t if t in FILES else f"{t}/__init__" for t in imports_of(name)} for name in FILES if name != "__init__"
    }
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, " -> ".join([*above, name])
        if name in done or name not in graph:
            return
        for target in graph[name] - {name}:
            visit(target, (*above, name))
        done.add(name)

    for name in graph:
        visit(name, ())


def bodies():
    for tree in FILES.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                yield (body[-1].end_lineno - body[0].lineno + 1) if body else 0


def test_functions_are_short():
    lengths = sorted(bodies())
    assert statistics.median(lengths) <= 10
    assert lengths[int(0.9 * (len(lengths) - 1))] <= 30
    assert lengths[-1] <= 60


def test_files_are_one_idea():
    assert max(path.read_text().count("\n") for path in SRC.rglob("*.py")) <= 450


def public_definitions(tree: ast.Module | ast.ClassDef):
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from public_definitions(node)


def test_public_names_are_documented():
    missing = [
        f"{name}.{node.name}"
        for name, tree in FILES.items()
        for node in public_definitions(tree)
        if not ast.get_docstring(node)
    ]
    assert not missing


ROOT = Path(__file__).parents[1]


def test_every_package_of_the_gate_has_an_exact_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [
        *project["dependencies"],
        *(name for extra in project["optional-dependencies"].values() for name in extra),
    ]
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in lines), lines
    plain = lambda name: re.sub(r"[-_.]+", "-", name).lower()  # noqa: E731
    exact = {plain(line.partition("==")[0]) for line in lines}
    assert not {plain(re.match(r"[\w.-]+", line)[0]) for line in wanted} - exact


def test_no_test_hangs_on_a_clock():
    """But that of the killed runs, which takes it for the moments of its kills."""
    clocks = re.compile(r"\b(perf_counter|process_time|monotonic|time\.time)\b")
    tests = [path for path in (ROOT / "tests").rglob("*.py") if path.name not in ("test_house.py", "test_resume.py")]
    assert [path.name for path in tests if clocks.search(path.read_text(encoding="utf-8"))] == []
