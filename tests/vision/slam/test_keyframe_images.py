"""Images of old keyframes: in memory, in a file without a name, or where the source has them; gone, they are counted."""

import errno
import gc
import os
import tempfile

import numpy as np
import pytest

from tspslam import InputError
from tspslam.vision.slam.keyframes.images import KeyframeImages
from tspslam.vision.slam.keyframes.settings import MapSettings
from tspslam.vision.slam.odometry import StereoOdometry, Tracking

from ...sequences import DETECTOR, RIG, corridor

SHAPE = 20, 30


def image(index, shape=SHAPE):
    return np.random.default_rng(index).integers(0, 256, shape).astype(np.uint8)


def filled(count, room=2):
    """Images of which so many are held in memory."""
    images = KeyframeImages(room * image(0).nbytes)
    for index in range(count):
        images.add(index, image(index))
    return images


class Narrow:
    """A file of which writing fails, or is cut short, once it has so many bytes."""

    def __init__(self, file, most, *, is_short=False):
        self._file, self.most, self._is_short = file, most, is_short

    def write(self, data):
        if self._file.tell() + len(data.tobytes()) > self.most:
            if self._is_short:
                return self._file.write(data.tobytes()[:7])
            raise OSError(errno.ENOSPC, "No space left on device")
        return self._file.write(data)

    def __getattr__(self, name):
        return getattr(self._file, name)


def narrow(monkeypatch, images_that_fit, *, is_short=False):
    """Let temporary files have room for so many images."""
    made, most = tempfile.TemporaryFile, images_that_fit * image(0).nbytes
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **given: Narrow(made(**given), most, is_short=is_short))


def test_images_are_what_they_were_wherever_they_are():
    images = filled(9)
    assert len(images._held) == 2
    for index in (0, 8, 3, 0):
        assert np.array_equal(images.get(index), image(index))
    assert 9 not in images
    assert images.get(9) is None
    assert images.forgotten == 0
    images.close()


def test_places_of_dropped_images_are_used_again():
    images = filled(9)
    end = images._end
    for index in range(7):
        images.drop(index)
        assert images.get(index) is None
    for index in range(9, 16):
        images.add(index, image(index))
    assert images._end == end
    assert all(np.array_equal(images.get(index), image(index)) for index in range(7, 16))
    images.drop(15)
    assert 15 not in images
    images.close()


@pytest.mark.parametrize("is_short", [True, False])
def test_what_a_full_disk_has_no_room_for_is_forgotten_and_counted(monkeypatch, is_short):
    narrow(monkeypatch, 3, is_short=is_short)
    images = filled(9)
    assert images.forgotten == 4  # of nine, two are in memory and three in the file
    assert [index for index in range(9) if index in images] == [0, 1, 2, 7, 8]
    assert all(np.array_equal(images.get(index), image(index)) for index in (0, 1, 2, 7, 8))
    images.drop(1)
    images.add(9, image(9))  # there is room again for one
    assert images.forgotten == 4
    assert np.array_equal(images.get(7), image(7))
    images.close()


def test_where_no_file_can_be_made_images_are_forgotten(monkeypatch):
    def refuse(**_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    images = filled(5)
    assert images.forgotten == 3
    assert images.get(0) is None
    assert np.array_equal(images.get(4), image(4))


def test_an_image_that_cannot_be_read_back_is_forgotten_once():
    images = filled(5)
    images._file.truncate(0)
    assert images.get(1) is None
    assert images.get(1) is None
    assert images.forgotten == 1
    images.close()


def test_the_file_is_closed_with_the_images_and_has_no_name():
    images = filled(5)
    file = images._file
    if os.name == "posix":
        assert os.fstat(file.fileno()).st_nlink == 0
    del images
    gc.collect()
    assert file.closed


def test_an_image_elsewhere_is_read_when_it_is_asked_for_and_once():
    asked = []

    def image_of(index):
        asked.append(index)
        return image(index)

    images = KeyframeImages(1e6, SHAPE)
    for index in range(5):
        images.add_elsewhere(index, image_of)
    assert asked == []
    assert all(index in images for index in range(5))
    for _ in range(2):
        assert np.array_equal(images.get(3), image(3))
    assert asked == [3]
    images.drop(2)
    assert images.get(2) is None


def gone(index):
    raise InputError(f"frame {index}: no such file")


def other(index):
    return image(index, (SHAPE[0], SHAPE[1] + 1))


@pytest.mark.parametrize("image_of", [gone, other])
def test_an_image_elsewhere_that_is_gone_or_another_is_forgotten(image_of):
    images = KeyframeImages(1e6, SHAPE)
    images.add_elsewhere(1, image_of)
    assert images.get(1) is None
    assert images.forgotten == 1
    assert 1 not in images


@pytest.mark.parametrize("is_there", [True, False])
def test_a_restored_map_knows_old_places_by_images_of_the_source_if_these_are_there(is_there):
    """A camera that is carried back is found, or stays lost: in no case does it end the run."""
    sequence = corridor(10.0)
    pairs = [sequence[k] for k in range(20)]
    tracking = Tracking(keyframe_share=0.9, map=MapSettings(image_bytes=0))
    one = StereoOdometry(RIG, detector=DETECTOR, tracking=tracking)
    for pair in pairs:
        one.process(pair)
    one.path.pose = one.mapper.join(one.path.pose)
    state, last = one.state(), one.map.keyframes[-3].index
    one.close()

    def image_of(number):
        if number < last and not is_there:
            raise InputError(f"frame {number}: no such file")
        return pairs[number].left

    with_images = StereoOdometry(RIG, detector=DETECTOR, tracking=tracking)
    with_images.restore(state, image_of)
    images, indices = with_images.map.images, [frame.index for frame in with_images.map.keyframes]
    assert images.forgotten == 0
    found = [images.get(index) for index in indices if index < last]
    assert all((each is not None) is is_there for each in found)
    assert images.forgotten == (0 if is_there else len(found))
    assert len(found) > 3
    with_images.close()


@pytest.mark.parametrize("error", [FileNotFoundError(), InputError("gone")])
def test_an_image_whose_source_is_gone_is_forgotten_once(error):
    def image_of(_):
        raise error

    images = filled(1)
    images.add_elsewhere(3, image_of)
    assert images.get(3) is None
    assert 3 not in images
    assert images.forgotten == 1


def test_after_it_is_closed_nothing_is_read_from_another_file():
    images = filled(9)
    images.close()
    for index in range(9, 15):  # which make a file anew
        images.add(index, image(index))
    assert images.get(1) is None
    assert all(np.array_equal(images.get(index), image(index)) for index in range(9, 15))
    images.close()
