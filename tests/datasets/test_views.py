"""Images of two cameras without a calibration."""

import numpy as np
import pytest

from tspslam.datasets.views import open_views
from tspslam.errors import InputError
from tspslam.io.images import write_png


def fill(folder, names, value=0):
    folder.mkdir(parents=True, exist_ok=True)
    for k, name in enumerate(names):
        write_png(folder / name, np.full((4, 6), value + k, np.uint8))


def pairs_of(views):
    return [tuple(int(image[0, 0]) for image in views.images(k)) for k in range(len(views))]


def test_two_folders_are_paired_by_name(tmp_path):
    fill(tmp_path / "a", ["1.png", "2.png", "10.png"], 1)
    fill(tmp_path / "b", ["2.png", "10.png"], 101)
    views = open_views([tmp_path / "a", tmp_path / "b"])
    assert views.names == ["2", "10"]
    assert pairs_of(views) == [(2, 101), (3, 102)]
    assert views.unpaired == ["a/1.png"]
    assert views.name == tmp_path.name
    assert views.stamps.tolist() == [1, 2]  # the first has no partner


@pytest.mark.parametrize(("left", "right"), [("left", "right"), ("cam0", "cam1"), ("image_0", "image_1")])
def test_one_folder_with_both_is_known_by_its_folders(tmp_path, left, right):
    fill(tmp_path / left, ["a.png", "b.png"], 1)
    fill(tmp_path / right, ["a.png", "b.png"], 101)
    assert pairs_of(open_views([tmp_path])) == [(1, 101), (2, 102)]


@pytest.mark.parametrize("form", ["left{:02}.png", "{:02}_left.png", "x-left-{:02}.png", "shot{:02} left.png"])
def test_names_tell_left_from_right_in_one_folder(tmp_path, form):
    fill(tmp_path, [form.format(k) for k in (1, 2, 3)], 1)
    fill(tmp_path, [form.replace("left", "right").format(k) for k in (1, 3)], 101)
    views = open_views([tmp_path])
    assert pairs_of(views) == [(1, 101), (3, 102)]
    assert len(views.unpaired) == 1


def test_folders_whose_names_differ_are_paired_by_number(tmp_path):
    fill(tmp_path / "a", ["one_0007.png", "one_0008.png"], 1)
    fill(tmp_path / "b", ["two-8.png", "two-9.png"], 101)
    assert pairs_of(open_views([tmp_path / "a", tmp_path / "b"])) == [(2, 101)]


def test_numbers_that_occur_twice_pair_nothing(tmp_path):
    fill(tmp_path / "a", ["p1.png", "q1.png"])
    fill(tmp_path / "b", ["x1.png", "y1.png"])
    with pytest.raises(InputError, match="2 files in a/ and 2 in b/ have no name in common"):
        open_views([tmp_path / "a", tmp_path / "b"])


def refused(paths, said, **kind):
    with pytest.raises(InputError) as caught:
        open_views(paths, **kind)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_source_is_refused_in_one_line(tmp_path):
    fill(tmp_path / "only", ["a.png", "b.png"])
    fill(tmp_path / "left", ["a.png"])
    (tmp_path / "empty").mkdir()
    (tmp_path / "right").mkdir()
    refused([tmp_path / "none"], "is not there")
    refused([], "0 sources are given, expected one or two")
    refused([tmp_path] * 3, "3 sources are given")
    refused([tmp_path / "only"], "does not tell left from right (it holds a.png, b.png)")
    refused([tmp_path / "empty"], "does not tell left from right (it holds nothing)")
    refused([tmp_path], "1 files in left/ and 0 in right/ have no name in common")
    refused([tmp_path / "only"], "is no bag, expected one with topics /l and /r", topics=("/l", "/r"))
    refused([tmp_path / "only", tmp_path / "left"], "is no video", layout="side-by-side")
    refused([tmp_path / "only", tmp_path / "only" / "a.png"], "is one image")


def test_a_damaged_image_is_an_error_of_its_own(tmp_path):
    fill(tmp_path / "left", ["a.png"])
    fill(tmp_path / "right", ["a.png"])
    (tmp_path / "right" / "a.png").write_bytes((tmp_path / "left" / "a.png").read_bytes()[:-9])
    views = open_views([tmp_path])
    with pytest.raises(InputError, match=r"a\.png"):
        list(views.images(0))


def test_a_video_is_opened_as_one(tmp_path):
    import cv2

    file = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"FFV1"), 10, (32, 16))
    for k in range(4):
        frame = np.full((16, 32, 3), 10 * k, np.uint8)
        frame[:, 16:] += 100
        writer.write(frame)
    writer.release()
    views = open_views([file], "side-by-side")
    assert len(views) == 4
    assert [int(np.ravel(image)[0]) for image in views.images(2)] == [20, 120]
    refused([file], "side-by-side")


def test_what_is_no_bag_is_refused_by_its_reader(tmp_path):
    pytest.importorskip("rosbags")
    (tmp_path / "a.bag").write_bytes(b"nothing")
    refused([tmp_path / "a.bag"], "a.bag")


def test_folders_give_what_stored_images_are(tmp_path):
    fill(tmp_path / "left", ["a.png"])
    fill(tmp_path / "right", ["a.png"])
    views = open_views([tmp_path])
    assert (views.name, len(views), len(views.stamps), list(views.unpaired)) == (tmp_path.name, 1, 1, [])
