"""Cameras from views of a board."""

from dataclasses import replace

import numpy as np
import pytest

from tspslam.errors import InputError
from tspslam.types import LENSES, RawRig
from tspslam.vision.calibration._board import _judging as judging
from tspslam.vision.calibration._board._adjustment import Seen
from tspslam.vision.calibration._board._lens import HELD, check_lens, is_sound, lens_doubts, rayless
from tspslam.vision.calibration._board._start import _FOCAL, place_board, start_camera
from tspslam.vision.calibration._board._views import unusable
from tspslam.vision.calibration.board import BoardView, Chessboard, Corners, calibrate

from .boards import BASELINE, CAMERAS, CHARUCO, CHESSBOARD, SIZE, T_RIGHT_LEFT, exact_views, places, rendered_views

NOTHING = Corners(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 3)), SIZE)


def shift(x=0.0, y=0.0):
    T = np.eye(4)
    T[:2, 3] = x, y
    return T


def off_focal(found, lens):
    pairs = zip((found.rig.left, found.rig.right), CAMERAS[lens], strict=True)
    return max(abs(getattr(a, key) / getattr(b, key) - 1) for a, b in pairs for key in ("fx", "fy"))


@pytest.mark.parametrize("lens", ["brown", "equidistant"])
@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO], ids=["chessboard", "charuco"])
def test_cameras_are_found_from_images(board, lens):
    found = calibrate(board, rendered_views(board, lens, count=10), lens=lens)
    assert off_focal(found, lens) < 0.002
    assert abs(found.baseline / BASELINE - 1) < 0.003
    assert max(found.error) < 0.35
    assert found.rows < 0.4


@pytest.mark.parametrize("lens", ["brown", "rational", "equidistant"])
def test_exact_corners_give_the_exact_cameras(lens):
    found = calibrate(CHESSBOARD, exact_views(lens=lens), lens=lens)
    assert off_focal(found, lens) < 1e-6
    assert np.abs(found.rig.matrix - T_RIGHT_LEFT).max() < 1e-7
    assert max(found.error) < 1e-4
    assert found.rows < 1e-3
    assert found.left_out == {}


def test_the_spread_that_is_told_is_the_spread_that_there_is():
    trials = [calibrate(CHESSBOARD, exact_views(noise=0.2, seed=seed, count=6)) for seed in range(10)]
    focal = [(found.rig.left.fx - 530) / found.focal_sd[0] for found in trials]
    base = [(found.baseline - BASELINE) / found.baseline_sd for found in trials]
    for z in (focal, base):
        assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.9


@pytest.mark.parametrize("count", [6, 7])
def test_a_focal_length_is_given_up_only_where_it_cannot_be_the_best(count):
    """The camera of least median error is that of a search through all, of even and odd numbers of views."""
    views = exact_views(noise=0.3, count=count)
    seen = [Seen(k, 0, view.left.xyz, view.left.uv) for k, view in enumerate(views)]
    found, _ = start_camera("brown", SIZE, seen)
    errors = []
    for f in SIZE[0] * _FOCAL:
        camera = np.array([f, f, *found[2:4], *np.zeros(5)])
        errors.append(np.median([min(place_board("brown", camera, each)[1], 1e3) for each in seen]))
    assert found[0] == SIZE[0] * _FOCAL[np.argmin(errors)]


def test_a_symmetric_board_that_is_numbered_from_its_other_end_gives_the_same():
    board = Chessboard(8, 6, 0.025)
    views = exact_views(board, noise=0.05)
    other = [view._replace(right=replace(view.right, uv=view.right.uv[::-1].copy())) for view in views]
    one, two = calibrate(board, views), calibrate(board, other)
    assert np.allclose(one.rig.matrix, two.rig.matrix, atol=1e-9)


def test_views_that_do_not_belong_are_named_and_spoil_nothing():
    views = exact_views(noise=0.05, count=14, moved={3: shift(0.004)})
    wrong = views[8].left.uv + np.random.default_rng(1).normal(0, 4, views[8].left.uv.shape)
    views[8] = views[8]._replace(left=replace(views[8].left, uv=wrong))
    views[5] = views[5]._replace(right=replace(views[5].right, blur=9.0))
    views[6] = views[6]._replace(left=NOTHING, right=NOTHING)
    found = calibrate(CHESSBOARD, views)
    assert found.left_out.keys() == {"03", "05", "06", "08"}
    assert found.left_out["03"].startswith("left and right do not belong together")
    assert found.left_out["05"] == "right image is blurred: edges are 9.0 px wide"
    assert found.left_out["06"] == "no corners found in either image"
    assert found.left_out["08"].startswith("corners of the left image are")
    assert off_focal(found, "brown") < 0.002
    assert [view.name for view in found.views] == [v.name for v in views if v.name not in found.left_out]


def test_a_view_of_one_camera_still_tells_of_that_camera():
    views = exact_views(noise=0.1, count=10)
    lone = [view._replace(right=NOTHING) if k in (2, 7) else view for k, view in enumerate(views)]
    found = calibrate(CHESSBOARD, lone)
    assert len(found.views) == 10
    assert np.isnan(found.views[2].right)
    assert np.isnan(found.views[2].rows)
    without = calibrate(CHESSBOARD, [view for k, view in enumerate(views) if k not in (2, 7)])
    assert found.focal_sd[0] < without.focal_sd[0]


def test_k3_is_free_only_where_corners_speak_for_it():
    plain = calibrate(CHESSBOARD, exact_views(noise=0.1))
    assert plain.held == ("k3",)
    assert plain.rig.left.distortion[4] == 0
    strong = dict(CAMERAS)
    cameras = [replace(camera, distortion=(-0.3, 0.1, 0.0, 0.0, 0.25)) for camera in CAMERAS["brown"]]
    CAMERAS["brown"] = tuple(cameras)
    try:
        bent = calibrate(CHESSBOARD, exact_views(noise=0.02, poses=places()))
    finally:
        CAMERAS.update(strong)
    assert bent.held == ()
    assert abs(bent.rig.left.distortion[4] - 0.25) < 0.1


@pytest.mark.parametrize("lens", ["rational", "equidistant"])
def test_coefficients_that_no_corner_tells_are_held(lens):
    for seed in (1, 2):
        found = calibrate(CHESSBOARD, exact_views(lens=lens, noise=0.3, seed=seed, span=(-0.2, 0.2)), lens=lens)
        assert found.held == HELD[lens]
        for camera in (found.rig.left, found.rig.right):
            values = dict(zip(LENSES[lens], camera.distortion, strict=True))
            assert all(values[name] == 0 for name in found.held)
            assert rayless(camera) == 0
        assert off_focal(found, lens) < 0.02
    exact = calibrate(CHESSBOARD, exact_views(lens=lens), lens=lens)
    assert exact.held == ()


def test_a_freed_coefficient_that_takes_rays_away_is_not_sound():
    camera = CAMERAS["equidistant"][0]
    rig = RawRig(camera, camera, tuple(map(tuple, T_RIGHT_LEFT)))
    folding = replace(camera, distortion=(0.02, -0.2, 0.0, 0.0))
    assert rayless(folding) > 0.3
    assert is_sound(rig, rig)
    assert not is_sound(rig, replace(rig, right=folding))


@pytest.mark.parametrize("lens", ["brown", "rational"])
def test_a_lens_that_folds_its_image_is_refused(lens):
    rest = (0.0,) * (len(LENSES[lens]) - 2)
    folding = replace(CAMERAS[lens][0], distortion=(-0.9, 0.0, *rest))
    with pytest.raises(InputError, match=r"folds its image.*views near the corners"):
        check_lens(RawRig(folding, folding, tuple(map(tuple, T_RIGHT_LEFT))))


def test_a_fisheye_lens_without_rays_is_told_or_refused():
    def rig(k2):
        camera = replace(CAMERAS["equidistant"][0], distortion=(0.02, k2, 0.0, 0.0))
        return RawRig(camera, camera, tuple(map(tuple, T_RIGHT_LEFT)))

    assert lens_doubts(rig(-0.005)) == {}
    assert "of the left image has no ray" in lens_doubts(rig(-0.1))["no_ray"]
    check_lens(rig(-0.1))
    with pytest.raises(InputError, match=r"% of the left image has no ray through this lens, .*views near the corners"):
        check_lens(rig(-1.5))


def test_a_place_that_is_shown_again_is_no_evidence():
    views = exact_views(noise=0.1, count=8)
    jitter = np.random.default_rng(5)

    def again(k, view):
        sides = {
            s: replace(getattr(view, s), uv=getattr(view, s).uv + jitter.normal(0, 0.1, 2)) for s in ("left", "right")
        }
        return view._replace(name=f"{view.name}-{k}", **sides)

    repeated = [again(k, view) for view in views for k in range(4)]
    found = calibrate(CHESSBOARD, repeated)
    assert [view.name for view in found.views] == [f"{view.name}-0" for view in views]
    assert found.left_out["03-2"] == "shows the board where 03-0 does"
    assert "8 views of both cameras" in found.warnings["few_views"]
    refused([again(k, view) for view in views[:2] for k in range(25)], "2 of 50 views can be used")


def test_a_board_numbered_from_its_other_end_is_the_same_place():
    board = Chessboard(8, 6, 0.025)
    view = exact_views(board, count=1)[0]
    sides = {s: replace(getattr(view, s), uv=getattr(view, s).uv[::-1].copy()) for s in ("left", "right")}
    near = replace(view.left, uv=view.left.uv + 3.0)
    views = [view, view._replace(name="turned", **sides), view._replace(name="near", left=near)]
    views.append(view._replace(name="lone", right=NOTHING))
    assert unusable(board, views) == {"turned": "shows the board where 00 does"}


def test_the_same_views_give_the_same_bytes():
    one, two = (calibrate(CHESSBOARD, exact_views(noise=0.1)) for _ in range(2))
    assert one.rig == two.rig
    assert one.focal_sd == two.focal_sd


def refused(views, said, board=CHESSBOARD, **kind):
    with pytest.raises(InputError) as caught:
        calibrate(board, views, **kind)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_where_no_image_shows_the_board_its_count_is_doubted():
    views = [BoardView("a", NOTHING, NOTHING)]
    refused(views, "; --board counts inner corners: a board of 10x7 squares is 9x6", Chessboard(10, 7, 0.025))
    refused(views, "; --charuco counts COLUMNSxROWS of squares; or is it 7x5?", CHARUCO)
    with pytest.raises(InputError) as caught:
        calibrate(CHESSBOARD, exact_views(count=3))
    assert "counts" not in str(caught.value)


def spoilt(**parts):
    views = exact_views(count=6)
    return [*views[:5], views[5]._replace(left=replace(views[5].left, **parts))]


@pytest.mark.parametrize(
    ("views", "said"),
    [
        (None, "views are NoneType, expected a sequence of BoardView"),
        ([None], "view is NoneType, expected a BoardView"),
        ([BoardView("a", None, NOTHING)], "left corners of a is NoneType, expected a Corners"),
        ([BoardView(None, NOTHING, NOTHING)], "name of a view is NoneType"),
        ([BoardView("a", NOTHING, NOTHING)] * 2, "two views have the name 'a'"),
        (spoilt(uv=np.full((54, 2), np.nan)), "left corners of 05 have NaN"),
        (spoilt(uv=np.zeros((53, 2))), "left corners of 05 have the shapes"),
        (spoilt(xyz=CHESSBOARD.corners * (1, 0, 0)), "do not span the plane"),
        (spoilt(ids=np.arange(3), uv=np.zeros((3, 2)), xyz=np.eye(3)), "are 3, expected none, or 6 or more"),
    ],
)
def test_what_are_no_views_is_named(views, said):
    refused(views, said)


def test_what_is_no_board_is_named():
    for board in (None, "9x6"):
        with pytest.raises(InputError, match="expected a Chessboard or a Charuco"):
            calibrate(board, exact_views())


def test_too_few_views_are_refused():
    views = exact_views(count=8)
    half = [view._replace(right=NOTHING) for view in views[:4]] + views[4:]
    refused(half, "4 of 8 views can be used, expected 5 or more that both cameras see")
    refused([], "there are no views")
    refused([BoardView("a", NOTHING, NOTHING)], "(a: no corners found in either image)")


def test_a_board_that_was_never_tilted_is_refused():
    refused(exact_views(noise=0.1, tilt=1.0), "planes of the board differ by")


def test_a_board_in_one_half_of_the_image_is_told():
    found = calibrate(CHESSBOARD, exact_views(noise=0.02, span=(0.12, 0.5), poses=near_the_right()))
    assert "right half of the left image" in found.warnings["one_half"]


def near_the_right():
    from .boards import project

    cameras = CAMERAS["brown"]
    found = [T for T in places(count=60) if (project(cameras[0], CHESSBOARD.corners, T)[:, 0] > 310).mean() > 0.95]
    return found[:12]


def test_a_focal_length_that_stays_open_is_refused_with_the_half():
    with pytest.raises(InputError, match="corners lie in the right half of an image, expected at most 1 %"):
        judging.check_determined(40.0, (0.02, 0.005), ("right", ""))
    judging.check_determined(40.0, (0.009, 0.005), ("right", ""))


def test_a_square_in_millimetres_is_guessed_at():
    board = Chessboard(9, 6, 2.5)
    views = [
        view._replace(left=replace(view.left, xyz=board.corners), right=replace(view.right, xyz=board.corners))
        for view in exact_views(noise=0.05)
    ]
    refused(views, "the cameras are 12 m apart, expected 0.005 to 5 m; is --square in metres?", board)


def test_left_and_right_that_were_swapped_are_told():
    swapped = [BoardView(view.name, view.right, view.left) for view in exact_views(noise=0.05)]
    refused(swapped, "the right camera is 0.12 m to the left of the left one, expected LEFT before RIGHT")


def test_cameras_above_each_other_are_told():
    T = np.eye(4)
    T[:3, 3] = 0.0, -0.1, 0.0
    with pytest.raises(InputError, match="expected it beside it"):
        judging.check_pose(T)


def test_images_of_two_sizes_are_refused():
    views = exact_views()
    views[4] = views[4]._replace(left=replace(views[4].left, size=(320, 240)))
    refused(views, "images have 640 x 480 px")
    huge = [v._replace(**{s: replace(getattr(v, s), size=(40_000, 480)) for s in ("left", "right")}) for v in views]
    refused(huge, "expected at most 32766 a side")


def test_an_unknown_lens_is_named():
    refused(exact_views(), "lens is 'mei', expected one of brown, rational, equidistant", lens="mei")


def test_few_and_flat_views_are_told():
    found = calibrate(CHESSBOARD, exact_views(noise=0.02, count=6, tilt=12.0))
    assert "6 views of both cameras" in found.warnings["few_views"]
    assert "little_tilt" in found.warnings


def test_each_warning_has_its_cause():
    good = judging.doubts(12, 60.0, (0.001, 0.001), (0.6, 0.6), ("", ""), (0.2, 0.2), 0.2)
    assert good == {}
    told = judging.doubts(6, 20.0, (0.004, 0.001), (0.2, 0.6), ("", "left"), (0.7, 0.2), 0.8)
    assert told.keys() == {
        "few_views", "little_tilt", "coverage", "one_half", "focal_spread", "reprojection", "rows_differ",
    }  # fmt: skip


def test_coverage_counts_cells():
    u, v = np.meshgrid(np.arange(0, 320, 10.0), np.arange(0, 480, 10.0))
    uv = np.column_stack([u.ravel(), v.ravel()])
    assert judging.coverage(uv, SIZE) == 0.5
    assert judging.half_of(uv, SIZE) == "left"
    assert judging.half_of(np.vstack([uv, np.add(uv, (320, 0))]), SIZE) == ""
