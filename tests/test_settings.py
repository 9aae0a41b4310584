"""Settings: each is documented and held to its range; names of before lead to those of now; groups go to any depth."""

import importlib.util
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import tspslam
from tspslam import InputError, Patches, Settings, Tracking, list_settings
from tspslam._settings import check_settings, copy_setting, setting
from tspslam._yaml import dump_yaml
from tspslam.run.config import RENAMED, describe, flatten, resolve, tabulate
from tspslam.settings import KINDS, PRESETS, find_kind

ROWS = {f"{row.name}, {row.kind}": row for row in list_settings()}
NUMBERS = {name: row for name, row in ROWS.items() if row.default is not None and type(row.default) in (int, float)}


@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
def test_every_setting_of_every_kind_has_a_meaning_a_unit_a_source_and_a_range(row):
    assert row.meaning
    assert row.unit is not None  # "" is said of a plain number
    assert len(row.unit) <= 30
    assert row.source
    assert row.range
    if type(row.default) in (int, float):
        assert None not in (row.low, row.high)
        assert row.low <= row.default <= row.high


@pytest.mark.parametrize("row", NUMBERS.values(), ids=NUMBERS)
def test_a_number_out_of_its_range_is_refused_by_name(row):
    stage = row.name.split(".")[0]
    for value in (type(row.default)(row.high + 1), type(row.default)(row.low - 1), float("nan")):
        with pytest.raises(InputError) as caught:
            resolve(assignments=[f"{stage}.kind={row.kind}", f"{row.name}={value}".replace("nan", ".nan")])
        assert str(caught.value).startswith(f"--set: {row.name} is {value}, expected ")


@pytest.mark.parametrize("row", NUMBERS.values(), ids=NUMBERS)
def test_the_class_of_a_stage_refuses_it_too(row):
    owner: type = KINDS[row.name.split(".")[0]][row.kind]
    *groups, name = row.name.split(".")[1:]
    for group in groups:
        owner = type(getattr(owner(), group))
    for value in (row.high + 1, row.low - 1, float("nan"), True, "7", None):
        with pytest.raises(InputError, match=f"{name} is .*, expected "):
            owner(**{name: value})


# ---- names


def old_names():
    for old, new in RENAMED.items():
        yield old, new
        for row in list_settings():
            if row.name.startswith(f"{new}."):
                yield row.name.replace(new, old), row.name


@pytest.mark.parametrize(("old", "new"), sorted(set(old_names())))
def test_a_setting_by_its_old_name_is_told_the_new_one(old, new, tmp_path):
    said = f"the setting '{old}' is now called {new}"
    with pytest.raises(InputError) as caught:
        resolve(assignments=[f"{old}=3"])
    assert str(caught.value) == f"--set: {said}"
    stage, *rest = old.split(".")
    file = tmp_path / "my.yaml"
    tree = 3
    for key in reversed(rest):
        tree = {key: tree}
    file.write_text(dump_yaml({stage: tree}), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        resolve(file=file)
    assert str(caught.value) == f"{file}: {said}"
    with pytest.raises(InputError, match=f"config show: {said}"):
        describe(resolve(), [old])


def test_the_config_of_an_old_run_is_refused_with_the_new_name(tmp_path):
    tree = resolve().nested | {"source": {"kind": "pair"}}
    matcher = tree["matcher"]
    matcher["windows"], matcher["back_windows"] = matcher.pop("patches"), matcher.pop("back_patches")
    file = tmp_path / "config.yaml"
    file.write_text("# tspslam run\n" + dump_yaml(tree), encoding="utf-8")
    with pytest.raises(
        InputError, match=r"config\.yaml: the setting 'matcher.*windows.*' is now called matcher.*patches"
    ):
        resolve(file=file)


def test_old_names_are_names_no_more_and_new_ones_are():
    names = {row.name for row in list_settings()}
    groups = {name.rpartition(".")[0] for name in names}
    assert not set(RENAMED) & (names | groups)
    assert set(RENAMED.values()) <= names | groups


# ---- groups


@dataclass(frozen=True)
class Gates:
    """Gates.

    Parameters
    ----------
    width : float
        How wide they are.
    shape : {"round", "square"}
        How they look.
    """

    width: float = setting(3.0, 1, 10, unit="px", source="by hand")
    shape: Literal["round", "square"] = setting("round", unit="", source="by hand")

    def __post_init__(self) -> None:
        check_settings("gates", self)


@dataclass(frozen=True)
class Loops:
    """Loops.

    Parameters
    ----------
    count : int
        How many.
    gates : Gates
        Through which they go.
    """

    count: int = setting(2, 1, 5, unit="", source="by hand")
    gates: Gates = setting(Gates(width=4.0), source="tried on a street")

    def __post_init__(self) -> None:
        check_settings("loops", self)


@dataclass(frozen=True)
class Deep:
    """A stage with groups in groups.

    Parameters
    ----------
    loops : Loops
        As the name says.
    """

    loops: Loops = Loops()

    def __post_init__(self) -> None:
        if self.loops.gates.width > 2 * self.loops.count:
            raise InputError("deep: the gates are too wide")


@pytest.fixture
def deep(monkeypatch):
    monkeypatch.setitem(KINDS["tracking"], "deep", Deep)
    return "tracking.kind=deep"


def test_groups_of_settings_go_to_any_depth(deep, tmp_path):
    resolved = resolve(assignments=[deep, "tracking.loops.gates.width=2", "tracking.loops.gates.shape=square"])
    assert resolved.settings.tracking == Deep(Loops(gates=Gates(2.0, "square")))
    assert resolved.nested["tracking"] == {
        "kind": "deep",
        "loops": {"count": 2, "gates": {"width": 2.0, "shape": "square"}},
    }
    rows = describe(resolved, ["tracking.loops.gates"])
    assert list(rows) == ["tracking.loops.gates.width", "tracking.loops.gates.shape"]
    width = rows["tracking.loops.gates.width"]
    assert (width["default"], width["value"], width["range"], width["unit"]) == (4.0, 2.0, "1 to 10", "px")
    assert (width["source"], width["meaning"]) == ("tried on a street", "How wide they are.")
    assert rows["tracking.loops.gates.shape"]["range"] == "round, square"
    assert len(tabulate(rows)) == 3
    (tmp_path / "my.yaml").write_text(dump_yaml({"tracking": resolved.nested["tracking"]}), encoding="utf-8")
    assert resolve(file=tmp_path / "my.yaml").settings == resolved.settings


@pytest.mark.parametrize(("assignment", "said"), [
    ("tracking.loops.gates.width=20", "--set: tracking.loops.gates.width is 20.0, expected 1 to 10"),
    ("tracking.loops.gates.shape=flat", "--set: tracking.loops.gates.shape is 'flat', expected one of round, square"),
    ("tracking.loops.gates.widht=2", "unknown setting 'tracking.loops.gates.widht'; did you mean tracking.loops.gates.width?"),
    ("tracking.loops.count=many", "--set: tracking.loops.count is 'many', expected an integer"),
    ("tracking.loops.count=1", "--set: deep: the gates are too wide"),
])  # fmt: skip
def test_a_wrong_value_in_a_group_is_named_in_full(deep, assignment, said):
    with pytest.raises(InputError) as caught:
        resolve(assignments=[deep, assignment])
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_group_where_a_setting_goes_is_told_its_settings():
    with pytest.raises(
        InputError, match=r"unknown setting 'filter'; it is a group: filter\.kind, filter\.order, filter\.c"
    ):
        resolve(assignments=["filter=tmahf"])


@pytest.mark.parametrize(("chosen", "name", "said"), [
    ("detector.kind=sift", "detector.fast_threshold", "detector.fast_threshold belongs to kind orb; detector.kind is sift"),
    ("detector.kind=grid", "detector.contrast_threshold", "belongs to kind sift; detector.kind is grid"),
    ("detector.kind=grid", "detector.count", "belongs to kinds orb, sift, brisk"),
    ("matcher.kind=sgbm", "matcher.patches.radius", "belongs to kind"),
    ("matcher.kind=sgbm", "matcher.patches", "matcher.patches belongs to kind"),
    ("surface.kind=crust", "surface.min_angle", "surface.min_angle belongs to kind delaunay; surface.kind is crust"),
])  # fmt: skip
def test_a_setting_of_another_kind_is_said_to_be_one(tmp_path, chosen, name, said):
    (tmp_path / "my.yaml").write_text(f"{name}: 10\n", encoding="utf-8")
    for ask in (
        lambda: resolve(assignments=[chosen, f"{name}=10"]),
        lambda: resolve(file=str(tmp_path / "my.yaml"), assignments=[chosen]),
        lambda: describe(resolve(assignments=[chosen]), [name]),
    ):
        with pytest.raises(InputError) as caught:
            ask()
        assert said in str(caught.value)
        assert "unknown" not in str(caught.value)


def test_a_name_near_to_none_is_told_the_groups_alone():
    for ask in (lambda: describe(resolve(), ["TYPO"]), lambda: resolve(assignments=["TYPO=1"])):
        with pytest.raises(InputError) as caught:
            ask()
        assert str(caught.value).endswith("unknown setting 'TYPO'; known are groups: " + ", ".join(KINDS))
    with pytest.raises(InputError, match=r"known are groups: tracking\.kind, .*tracking\.pose, .*") as caught:
        describe(resolve(), ["tracking." + 40 * "Q"])
    assert "tracking.pose." not in str(caught.value)


def test_a_choice_is_one_of_its_values():
    assert Gates(shape="square").shape == "square"
    for shape in ("flat", None, ["round"]):
        with pytest.raises(InputError, match=r"gates: shape is .*, expected one of round, square"):
            Gates(shape=shape)


def test_a_copied_setting_is_the_same():
    @dataclass(frozen=True)
    class Other:
        width: float = copy_setting(Gates, "width")

    assert Other() == Other(3.0)
    assert Other.__dataclass_fields__["width"].metadata == Gates.__dataclass_fields__["width"].metadata


# ---- stages and presets


def test_there_is_one_paper_preset(motorcycle):
    paper = resolve("paper").settings
    assert paper == PRESETS["paper"]
    again = tspslam.reconstruct(motorcycle, matcher=paper.matcher)
    assert (again.uv == tspslam.reconstruct(motorcycle, preset="paper").uv).all()
    assert resolve().settings == PRESETS["default"] == Settings()
    with pytest.raises(InputError, match="preset is 'best', expected one of default, paper"):
        resolve("best")


def test_the_first_kind_of_a_stage_is_the_default():
    for stage, kinds in KINDS.items():
        assert find_kind(Settings(), stage) == next(iter(kinds))


def test_every_stage_is_a_public_name_with_an_example():
    stages = [kind for kinds in KINDS.values() for kind in kinds.values()]
    for kind in (*stages, Patches):
        assert kind.__name__ in tspslam.__all__
        assert getattr(tspslam, kind.__name__) is kind
        assert ">>> " in kind.__doc__


def test_a_function_of_ones_own_has_no_settings():
    own: Callable[..., object] = lambda grey: None  # noqa: E731
    with pytest.raises(InputError, match="detector is function, expected one with settings: OrbDetector"):
        list_settings(replace(Settings(), detector=own))


def test_settings_are_read_without_a_kernel():
    """And names of the package without NumPy: what is imported is counted, no time is taken."""
    code = "import sys, tspslam{}; print(*(name for name in ('numpy', 'numba', 'cv2', 'scipy') if name in sys.modules))"
    for what, expected in (("", ""), (".settings", "numpy")):
        done = subprocess.run([sys.executable, "-c", code.format(what)], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == expected


def test_every_setting_is_on_the_page_of_settings():
    path = Path(__file__).parents[1] / "docs" / "settings_page.py"
    spec = importlib.util.spec_from_file_location("settings_page", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    text = module.page()
    for row in list_settings():
        assert f"``{row.name}``" in text
        assert module.escaped(row.source) in text
        assert row.meaning in text


@pytest.mark.parametrize("value", [1, 1.0, np.float32(1), np.int64(1)])
def test_equal_values_are_one_setting(value):
    assert flatten(Settings(tracking=Tracking(sigma_disparity=value)))["tracking.sigma_disparity"] == 1.0
    assert type(Tracking(sigma_disparity=value).sigma_disparity) is float


@pytest.mark.parametrize(("text", "said"), [
    ("nonsense: {}", "unknown setting 'nonsense'"),
    ("matcher: {windows: {}}", "matcher.patches"),
    ("tracking: {pose: {min_matches: {}}}", "tracking.pose.min_matches"),
])  # fmt: skip
def test_empty_groups_of_a_file_are_named_too(tmp_path, text, said):
    (tmp_path / "s.yaml").write_text(text)
    with pytest.raises(InputError, match=said):
        resolve(file=tmp_path / "s.yaml")
    (tmp_path / "s.yaml").write_text("tracking: {pose: {}}")
    assert resolve(file=tmp_path / "s.yaml").settings == Settings()


@pytest.mark.parametrize("stage", ["detector", "matcher", "tracking", "surface", "filter"])
@pytest.mark.parametrize("wrong", [3, None, {}, []])
def test_what_is_no_stage_is_named(stage, wrong):
    with pytest.raises(InputError, match=f"settings: {stage} is .*, expected a "):
        Settings(**{stage: wrong})
