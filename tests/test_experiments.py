"""Each experiment runs on a small setting and obeys its laws; what lacks its data is skipped by name."""

import importlib
import json
from pathlib import Path

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

import tspslam
from experiments import damage
from experiments.__main__ import NAMES, main
from experiments.answer_a_what_it_sees import ramp, ramp_errors, respond
from experiments.common import Source, reference_gradient
from experiments.fig07_heat_and_hops import decay, fit
from experiments.fig08_angles import interior_angles
from experiments.page import escaped, said

SOURCE = Source(small=True)


@pytest.fixture(scope="module")
def results():
    found = {}

    def run(name):
        if name not in found:
            found[name] = importlib.import_module(f"experiments.{name}").run(SOURCE)
        return found[name]

    return run


@pytest.mark.parametrize("name", NAMES)
def test_an_experiment_gives_a_picture_rows_and_numbers(results, name):
    result = results(name)
    assert result.figure.get_axes()
    assert len({len(column) for column in result.table.values()}) == 1
    assert result.numbers
    known = [value for value in result.numbers.values() if not isinstance(value, str)]
    assert np.isfinite(known).all()


def test_scripts_are_short():
    folder = Path(damage.__file__).parent
    lengths = {name: (folder / f"{name}.py").read_text(encoding="utf-8").count("\n") for name in NAMES}
    assert max(lengths.values()) < 80, lengths


def test_the_toy_complex_is_that_of_the_figure(results):
    numbers = results("fig02_toy_complex").numbers
    assert list(numbers.values()) == [5, 7, 3, 0]


def test_heat_decays_with_hops_and_a_fit_finds_an_exponential(results):
    table = results("fig07_heat_and_hops").table
    assert (np.diff(table["K_median"]) < 0).all()
    hops = np.repeat(np.arange(1, 9), 50)
    best, covariance, R2 = fit(hops, decay(hops, 0.3, 1.2))
    np.testing.assert_allclose(best, (0.3, 1.2), rtol=1e-6)
    assert covariance.max() < 1e-12
    assert pytest.approx(1) == R2


def test_angles_are_those_of_known_triangles_and_err_with_the_spread_of_depth(results):
    right = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0]])
    np.testing.assert_allclose(interior_angles(right, np.array([[0, 1, 2]])), [[90, 45, 45]])
    error = np.array(results("fig08_angles").table["median_error_deg"])
    assert error[7:].mean() > 2 * error[:3].mean()


def test_crust_is_exact_on_the_tori(results):
    table = results("fig11_12_tori").table
    assert table["crust_faces"] == [2 * n for n in table["N"]]
    assert table["crust_euler"] == [0, 0]
    assert all(0.4 * n < seen < 0.7 * n for n, seen in zip(table["N"], table["visible"], strict=True))


def test_constants_are_silent_and_ramps_exact(results):
    numbers = results("answer_a_what_it_sees").numbers
    assert numbers["none: constant / real"] > 0.2
    assert all(numbers[f"{c}: constant / real"] < 1e-9 for c in ("mean", "harmonic", "plane"))
    assert numbers["plane: ramps, all: 95 %, degrees"] < 1e-6
    assert numbers["harmonic: ramps, all: median, degrees"] < numbers["none: ramps, all: median, degrees"]


def test_a_ramp_has_its_gradient_as_reference():
    frame = SOURCE.frames(1)[0]
    image = ramp(frame.rig.width, frame.rig.height, 0.7)
    gradient, sigma = reference_gradient(image, frame.cloud.uv, frame.complex_)
    inside = ((frame.cloud.uv > 40) & (frame.cloud.uv < (216, 152))).all(axis=1)
    np.testing.assert_allclose(np.angle(gradient[inside]), 0.7, atol=0.02)
    assert (sigma > 0).all()
    assert np.median(ramp_errors(frame, "plane", 4)[0]) < 1e-6
    assert respond(frame, image, "plane").defined.any()


def test_nothing_moves_without_damage_and_more_with_more(results):
    table = results("answer_b_bad_meshes").table
    amount, move = np.array(table["amount"]), np.array(table["move_median"])
    assert (move[amount == 0] < 1e-12).all()
    for kind in ("flip", "delete", "jitter"):
        of = (np.array(table["damage"]) == kind) & (np.array(table["filter"]) == "MAHF graph")
        assert (np.diff(move[of]) >= 0).all()


def test_a_flip_keeps_the_number_of_edges_and_faces_and_the_boundary():
    faces = SOURCE.frames(1)[0].surface.faces
    n = int(faces.max()) + 1
    flipped = damage.flip(faces, 0.2, np.random.default_rng(0))
    before, after = tspslam.build_complex(faces, n), tspslam.build_complex(flipped, n)
    assert len(before.edges) == len(after.edges)
    assert len(before.faces) == len(after.faces)
    changed = (np.sort(before.faces, axis=1) != np.sort(flipped, axis=1)).any(axis=1).sum()
    assert 0.2 * len(before.edges) * 0.8 < changed / 2 <= 0.2 * len(before.edges)
    assert [np.bincount(c.face_edges.ravel()).max() for c in (before, after)] == [2, 2]


def test_the_share_really_flipped_is_told_also_where_it_is_less_than_was_asked_for(results):
    faces = SOURCE.frames(1)[0].surface.faces
    shares = [
        damage.share_flipped(faces, damage.flip(faces, asked, np.random.default_rng(0))) for asked in (0, 0.1, 0.4, 0.9)
    ]
    np.testing.assert_allclose(shares[:2], (0, 0.1), atol=2e-3)
    assert 0.25 < shares[2] < 0.4
    assert shares[3] == shares[2]
    table = results("answer_b_bad_meshes").table
    of = np.array(table["damage"]) == "flip"
    np.testing.assert_allclose(np.array(table["done_median"])[of], np.array(table["amount"])[of], atol=2e-3)


def test_no_function_of_hops_explains_more_than_the_mean_of_each_ring(results):
    numbers = results("fig07_heat_and_hops").numbers
    assert numbers["R² on K"] < numbers["R² on K of the mean at each number of hops"] < 1
    assert numbers["pairs within 3 hops"] < numbers["pairs"]


def test_the_reference_is_as_wide_as_it_is_told_to_be():
    frame = SOURCE.frames(1)[0]
    image = ramp(frame.rig.width, frame.rig.height, 0.0)
    half, whole = (reference_gradient(image, frame.cloud.uv, frame.complex_, width)[1] for width in (0.25, 0.5))
    np.testing.assert_allclose(whole, 2 * half)


def test_noise_makes_phases_worse(results):
    table = results("answer_d_edges_and_faces").table
    rows = list(zip(*table.values(), strict=True))
    for levels in ("vertices", "+ edges", "+ faces"):
        change = [row[3] for row in rows if row[1:3] == (levels, "left to right, all")]
        assert change[0] > change[2] > change[-1]


def test_memory_grows_with_the_number_of_points(results):
    table = results("answer_e_scale").table
    assert (np.diff(table["megabytes"]) > 0).all()


def test_results_are_written_whole_with_a_page(tmp_path, capsys):
    out, docs = tmp_path / "out", tmp_path / "docs"
    docs.mkdir()
    assert main(["fig02_toy_complex", "--out", str(out), "--docs", str(docs)]) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "fig02_toy_complex.csv", "fig02_toy_complex.png", "results.json",
    ]  # fmt: skip
    assert json.loads((out / "results.json").read_text())["fig02_toy_complex"]["numbers"]["faces"] == 3
    assert "a toy complex" in (docs / "paper.rst").read_text(encoding="utf-8")
    assert (docs / "images" / "paper" / "fig02_toy_complex.png").stat().st_size > 10_000
    assert (out / "fig02_toy_complex.csv").read_text().splitlines()[0] == "edge,from,to"


def test_one_name_leaves_the_results_and_the_sections_of_the_others(tmp_path, capsys):
    out, docs = tmp_path / "out", tmp_path / "docs"
    docs.mkdir()
    other = {"numbers": {"faces": 41}, "paper": {}, "seconds": 1.0}
    (docs / "paper_results.json").write_text(json.dumps({"fig06_edges_and_faces": other, "gone": other}))
    out.mkdir()
    (out / "results.json").write_text(json.dumps({"fig08_angles": other}))
    assert main(["fig02_toy_complex", "--out", str(out), "--docs", str(docs)]) == 0
    assert list(json.loads((out / "results.json").read_text())) == ["fig02_toy_complex", "fig08_angles"]
    kept = json.loads((docs / "paper_results.json").read_text())
    assert list(kept) == ["fig02_toy_complex", "fig06_edges_and_faces"]
    assert kept["fig06_edges_and_faces"] == other
    assert kept["fig02_toy_complex"]["of"] == "Motorcycle, synthetic"
    page = (docs / "paper.rst").read_text(encoding="utf-8")
    assert page.index("Figure 2") < page.index("Figure 6: signals") < page.index("- 41")
    assert main(["fig02_toy_complex", "--small", "--out", str(out)]) == 0
    both = json.loads((out / "results.json").read_text())
    assert both["fig08_angles"] == other
    assert both["fig02_toy_complex"]["of"] == "small scenes"


@pytest.mark.parametrize("option", [["--small"], ["--data", "drive"]])
def test_the_page_is_not_written_from_small_scenes_or_other_data(option, tmp_path, capsys):
    docs = tmp_path / "docs"
    line = refused(["fig02_toy_complex", *option, "--out", str(tmp_path / "o"), "--docs", str(docs)], capsys)
    assert f"--docs with {option[0]}" in line
    assert not docs.exists()


@pytest.mark.parametrize("option", ["--out", "--docs"])
@pytest.mark.parametrize("below", [".", "inside"])
def test_a_file_where_a_folder_is_wanted_is_refused(option, below, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("plain").write_text("mine")
    line = refused(["fig02_toy_complex", option, str(Path("plain") / below)], capsys)
    assert f"{option} plain" in line
    assert "is no folder" in line
    assert Path("plain").read_text() == "mine"


@pytest.mark.parametrize("held", ["half a {", "[]"])
def test_results_that_cannot_be_kept_are_not_written_over(held, tmp_path, capsys):
    (tmp_path / "results.json").write_text(held)
    assert "results.json" in refused(["fig02_toy_complex", "--out", str(tmp_path)], capsys)
    assert (tmp_path / "results.json").read_text() == held


def refused(arguments, capsys) -> str:
    """The one line with which arguments are refused, with exit code 2."""
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    return said.err


def test_a_figure_without_its_data_is_skipped_by_name_and_the_others_run(tmp_path, capsys):
    (tmp_path / "drive" / "left").mkdir(parents=True)
    code = main(
        ["fig04_keypoints", "fig02_toy_complex", "--data", str(tmp_path / "drive"), "--out", str(tmp_path / "o")]
    )
    assert code == 4
    assert "fig04_keypoints: skipped:" in (said := capsys.readouterr()).err
    assert "lacks the folder right" in said.err
    assert "fig02_toy_complex:" in said.out
    record = json.loads((tmp_path / "o" / "results.json").read_text())
    assert "lacks the folder right" in record["fig04_keypoints"]["skipped"]


def test_a_folder_is_used_and_too_few_pairs_or_a_bad_file_are_named(sequence, tmp_path, capsys):
    source = Source(sequence)
    assert [frame.name for frame in source.frames(3)] == ["000", "001", "002"]
    with pytest.raises(tspslam.InputError, match="has 3 pairs, the figure needs 4"):
        source.frames(4)
    (sequence / "right" / "000.png").write_bytes(b"no image")
    assert main(["fig06_edges_and_faces", "--data", str(sequence), "--out", str(tmp_path / "o")]) == 4
    assert "000.png" in capsys.readouterr().err


def test_an_unknown_experiment_is_a_usage_error(capsys):
    assert "no experiment is called fig99" in refused(["fig99"], capsys)


def test_numbers_and_text_are_fit_for_the_page():
    assert [said(x) for x in (3, 1200, 0.12345, 12.0, float("nan"), "a")] == [
        "3",
        "1 200",
        "0.123",
        "12",
        "refused",
        "a",
    ]
    assert escaped("|r| of `mean`") == "\\|r\\| of ``mean``"
    assert escaped(":doc:`synthetic`") == ":doc:`synthetic`"


def test_a_picture_is_a_thousand_pixels_wide_or_more(results):
    figure = results("answer_c_hops_or_heat").figure
    figure.canvas.draw()
    width, _ = figure.canvas.get_width_height()
    assert width >= 1000
