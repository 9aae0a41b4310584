"""The house keeps its shape: arrows point down, the wings never meet, functions stay short."""

import ast
import importlib.util
import re
import statistics
import tomllib
from pathlib import Path

import tspslam

SRC = Path(tspslam.__file__).parent
ROOT = Path(__file__).parents[1]
GROUND = {
    "_atomic",
    "_brief",
    "_cameras",
    "_channels",
    "_checks",
    "_files",
    "_jit",
    "_kernel_cache",
    "_lazy",
    "_npz",
    "_settings",
    "_stopwatch",
    "_text",
    "_threads",
    "_yaml",
    "types",
    "errors",
}
BELOW = {  # what each room may import, besides itself: docs/architecture.rst shows it
    "__main__": {"cli"},
    "cli": {"scale", "run", "view", "settings", "datasets", "vision", "topology", "printing"} | GROUND,
    "scale": {"run", "settings", "apps", "datasets", "io", "view", "vision", "topology"} | GROUND,
    "run": {
        "session",
        "settings",
        "apps",
        "frame",
        "topological_map",
        "mapping",
        "interop",
        "datasets",
        "io",
        "view",
        "vision",
    }
    | {"topology"}
    | GROUND,
    "interop": {"datasets", "io", "frame", "vision", "topology"} | GROUND,
    "session": {"settings", "frame", "vision", "topology"} | GROUND,
    "settings": {"mapping", "vision", "topology"} | GROUND,
    "datasets": {"vision", "io"} | GROUND,
    "io": {"frame", "topological_map", "topology", "vision"} | GROUND,
    "view": {"frame", "topological_map"} | GROUND,
    "apps": {"topology"} | GROUND,
    "mapping": {"frame", "topological_map", "vision", "topology"} | GROUND,
    "topological_map": {"topology"} | GROUND,
    "frame": {"vision", "topology"} | GROUND,
    "vision": GROUND,
    "topology": GROUND,
    "printing": {"errors"},
    "_atomic": {"_files", "errors"},
    "_files": {"_checks", "errors"},
    "_npz": {"_files", "errors"},
    "_text": {"_files"},
    "_yaml": {"_files", "_text"},
    "types": {"_brief", "_cameras", "_channels", "_checks", "errors"},
    "_cameras": {"errors"},
    "_brief": set(),
    "_channels": set(),
    "_checks": {"errors"},
    "_jit": {"_kernel_cache"},
    "_kernel_cache": set(),
    "_lazy": set(),
    "_settings": {"errors"},
    "_stopwatch": set(),
    "_threads": {"errors"},
    "errors": set(),
}
SHARED = {"rig", "se3", "images", "_sampling"}  # files of `vision` that its rooms may stand on
BELOW_IN_VISION = {
    "slam": {"stereo", "features"} | SHARED,
    "depth": set(),
    "stereo": {"features", "rig", "images", "_sampling"},
    "features": {"images"},
    "calibration": {"rig", "se3"},
    "visibility": {"_visibility", "rig"},
    "evaluate": {"se3"},
    "_visibility": set(),
    "_sampling": set(),
    "rig": set(),
    "se3": set(),
    "images": {"rig"},
}
PAGE = (ROOT / "docs" / "architecture.rst").read_text(encoding="utf-8")
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


def test_no_arrow_is_allowed_that_nothing_needs():
    """But those to the ground, on which every room may stand."""
    for below, first in ((BELOW, ""), (BELOW_IN_VISION, "vision/")):
        needed = {name: set() for name in below}
        for name in FILES:
            room, inner = name.removeprefix(first).split("/")[0], name.startswith(first) and name != f"{first}__init__"
            for target in imports_of(name) if inner else ():
                if target.startswith(first):
                    needed[room].add(target.removeprefix(first).split("/")[0])
        ground = {name: GROUND if first or name not in GROUND else set() for name in below}
        assert not {f"{name} -> {idle}" for name in below for idle in below[name] - ground[name] - needed[name]}


def test_the_architecture_page_shows_these_arrows():
    spec = importlib.util.spec_from_file_location("rooms", ROOT / "docs" / "rooms.py")
    drawing = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(drawing)
    rooms, inner = ({name: below for name, (_, below) in table.items()} for table in drawing.read_tables())
    assert rooms == {name: below - GROUND for name, below in BELOW.items() if name not in GROUND | {"__main__"}}
    kernels = {name for name in BELOW_IN_VISION if name.startswith("_")}
    expected = {name: BELOW_IN_VISION[name] - SHARED - kernels for name in BELOW_IN_VISION.keys() - SHARED - kernels}
    assert inner == expected
    assert rooms.keys() | inner.keys() <= drawing.ACROSS.keys() | drawing.WINGS.keys()


def test_files_that_the_architecture_page_names_are_there():
    named = re.findall(r"``([\w/]+\.py)``", PAGE)
    assert named
    assert not [name for name in named if not (SRC / name).exists() and not (ROOT / name).exists()]


def defined_in(file: str) -> set[str]:
    """Names that a file, below the package, defines for all to see."""
    tree = FILES[file.removesuffix(".py")].body
    found = {node.name for node in tree if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    targets = [t for n in tree for t in (n.targets if isinstance(n, ast.Assign) else [getattr(n, "target", None)])]
    return found | {target.id for target in targets if isinstance(target, ast.Name)}


def test_names_are_in_the_files_that_the_architecture_page_says():
    said = re.findall(r"`+(\w+)`+ of ``([\w/]+\.py)``", PAGE) + re.findall(r"`(\w+)`\s\(``([\w/]+\.py)``\)", PAGE)
    assert {"KINDS", "open_sequence", "export_command", "Matches", "Tracked", "Complex", "Frame"} <= {
        x for x, _ in said
    }
    assert [(name, file) for name, file in said if name not in defined_in(file)] == []
    assert len(re.findall("``KINDS`` of ``settings.py``", PAGE)) == PAGE.count("``KINDS``")
    walk = PAGE.partition("One pair's walk")[2].partition("Threads\n")[0]
    flowing = set(re.findall(r"^     - `([A-Z]\w+)`$", walk, re.MULTILINE))
    assert len(flowing) > 8
    assert not flowing - defined_in("types.py") - {name for name, _ in said}


def test_every_file_of_the_path_and_of_a_run_is_on_the_architecture_page():
    public = [name for name in FILES if name.startswith(("vision/slam/", "run/")) and "/_" not in name]
    assert not [name for name in public if f"``{name}.py``" not in PAGE]


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


SHAPE = r"\((?:\.{3}|\w+),(?: [\w, +*]+)?\)"  # (N,) and (N, 3), (..., 4, 4), (n + 1,)
DTYPE = r"\b(u?int(eger)?|float|complex|number|bool|str)\d*s?\b"


def public_functions():
    """File and node of each function and method that people may call, but properties and the command line's own."""
    for name, tree in FILES.items():
        if name.split("/")[-1].startswith("_") and not name.endswith("__init__"):
            continue
        for node in public_definitions(tree):
            marks = " ".join(ast.unparse(mark) for mark in node.decorator_list)
            if isinstance(node, ast.FunctionDef) and not re.search(r"property|setter|overload|command|callback", marks):
                yield name, node


def sections_of(node) -> dict[str, str]:
    parts = re.split(r"^(\w[\w ]*)\n-{3,}$", ast.get_docstring(node) or "", flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def entries_of(section: str) -> dict[str, str]:
    """A section's lines "name, name : type" with what is said below each."""
    lines = re.split(r"^(?=\S)", section.strip("\n"), flags=re.MULTILINE)
    return {line.partition("\n")[0]: line.partition("\n")[2] for line in lines if line.strip()}


def kinds_of(node) -> dict[str, str]:
    """What each name among a docstring's parameters is; where it says "as `other`", by that function's docstring."""
    kinds = {}
    for line, text in entries_of(sections_of(node).get("Parameters", "")).items():
        names, _, kind = line.partition(" : ")
        other = {} if kind else referred(re.search(r"\bas `(\w+)`", text, re.IGNORECASE))
        kinds |= {name: kind or other.get(name, "") for name in re.findall(r"\w+", names)}
    return referred(re.search(r"^Parameters\b[^.]*: as `(\w+)`", ast.get_docstring(node) or "", re.MULTILINE)) | kinds


def referred(found) -> dict[str, str]:
    functions = {node.name: node for _, node in public_functions()}
    return kinds_of(functions[found[1]]) if found and found[1] in functions else {}


def is_vague(kind: str, annotation: str) -> bool:
    """Whether an array lacks its shape or the type of its numbers."""
    is_array = re.search(r"Array|(?<!\.)\bImage\b(?!\.)", annotation) or re.search(r"\barrays?\b", kind)
    if not is_array or "Callable" in annotation or "sparse" in kind or kind.startswith("dict"):
        return False
    return not (re.search(SHAPE, kind) and re.search(DTYPE, kind))


def undocumented(node: ast.FunctionDef):
    """What a function takes or gives without saying so."""
    given = node.args
    named = [*given.posonlyargs, *given.args, *given.kwonlyargs, *filter(None, (given.vararg, given.kwarg))]
    kinds = kinds_of(node)
    for name, annotation in ((arg.arg, ast.unparse(arg.annotation)) for arg in named if arg.annotation):
        if not kinds.get(name):
            yield f"parameter {name} is missing"
        elif is_vague(kinds[name], annotation):
            yield f"parameter {name} : {kinds[name]}, expected a shape and a dtype"
    returned, sections = ast.unparse(node.returns), sections_of(node)
    found = entries_of(sections.get("Returns", "") or sections.get("Yields", ""))
    if returned in ("None", "NoReturn"):
        return
    if not found and not re.search(r"^[^.]*\breturns\b[^.]*: as `\w+`", ast.get_docstring(node), re.I | re.M):
        yield f"returns {returned}, which is missing"
    if found and (is_vague(" ".join(found), returned) or any(is_vague(line, "") for line in found)):
        yield f"returns {', '.join(found)}, expected a shape and a dtype"


def test_public_functions_say_what_they_take_and_give():
    wrong = [
        f"{name}:{node.lineno} {node.name}: {what}" for name, node in public_functions() for what in undocumented(node)
    ]
    assert not wrong, "\n".join(wrong)


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


def test_files_that_are_handed_out_first_are_there():
    """So that a file of another name does not come last, when a worker would be alone with it."""
    from tests.conftest import LONGEST

    assert len(set(LONGEST)) == len(LONGEST) > 10
    assert not [name for name in LONGEST if not (ROOT / name).exists()]
