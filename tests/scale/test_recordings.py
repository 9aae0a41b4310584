"""Lists and folders become recordings, each once, with a name of its own, the longest first."""

import pytest

from tspslam.errors import InputError
from tspslam.scale.recordings import Recording, find_sources, longest_first, open_recordings

from .recordings import TINY, write_walk


def hollow(folder, *names):
    """Folders that look like recordings, without images."""
    for name in names:
        for side in ("left", "right"):
            (folder / name / side).mkdir(parents=True)
    return [folder / name for name in names]


def test_a_list_is_relative_to_itself_and_may_hold_comments_folders_and_twins(tmp_path):
    hollow(tmp_path / "lists", "a", "b", "days/monday", "days/tuesday", "with blank#1")
    (tmp_path / "lists" / "all.txt").write_text(
        "# drives\n\n a  # the first\nb\r\n./a\ndays\nwith blank#1\nnot there\n", encoding="utf-8-sig"
    )
    found = find_sources([tmp_path / "lists" / "all.txt"])
    assert [each.name for each in found] == ["a", "b", "monday", "tuesday", "with blank#1", "not there"]
    assert all(each.is_absolute() for each in found)


def test_lines_that_no_disk_can_have_are_recordings_that_cannot_be_opened(tmp_path):
    names = ["a", "~nobody-of-this-name/walk", "y" * 300]
    hollow(tmp_path, "a")
    (tmp_path / "list.txt").write_text("\n".join(names))
    found = find_sources([tmp_path / "list.txt"])
    assert found == [tmp_path / name for name in names]
    assert all(each.error for each in open_recordings(found[1:], {}))
    assert find_sources([tmp_path / names[2]]) == [tmp_path / names[2]]


def test_a_folder_is_a_recording_or_holds_some_and_nothing_else_of_it_counts(tmp_path):
    hollow(tmp_path, "b", "a", ".hidden", "notes/deep")
    (tmp_path / "readme.txt").write_text("about them")
    (tmp_path / "runs" / "a" / "frames").mkdir(parents=True)
    assert find_sources([tmp_path]) == [tmp_path / "a", tmp_path / "b"]
    assert find_sources([tmp_path / "a"]) == [tmp_path / "a"]
    assert find_sources([tmp_path / "b", tmp_path]) == [tmp_path / name for name in ("b", "a")]


def test_files_of_recordings_are_no_lists(tmp_path):
    for name in ("drive.bag", "clip.mp4"):
        (tmp_path / name).write_bytes(b"\0")
    assert find_sources([tmp_path / "drive.bag", tmp_path / "clip.mp4"]) == [
        tmp_path / name for name in ("drive.bag", "clip.mp4")
    ]


@pytest.mark.parametrize(("content", "said"), [(b"# none\n", "names no recording"), (b"a\0b\n", "holds a zero byte")])
def test_a_list_that_names_nothing_or_is_no_text_is_refused(tmp_path, content, said):
    (tmp_path / "list.txt").write_bytes(content)
    with pytest.raises(InputError, match=said):
        find_sources([tmp_path / "list.txt"])


def test_work_is_told_without_an_image_decoded(tmp_path):
    write_walk(tmp_path / "walk", 2.0)
    for image in (tmp_path / "walk" / "left").iterdir():  # heads stay, so sizes are known
        image.write_bytes(image.read_bytes()[:100])
    (found,) = open_recordings([tmp_path / "walk"], {})
    assert (found.name, found.error, found.frames) == ("walk", "", 5)
    assert found.pixels == 5 * TINY.width * TINY.height


def test_one_that_cannot_be_opened_says_why(tmp_path):
    (found,) = open_recordings([tmp_path / "gone"], {})
    assert (found.name, found.frames) == ("gone", 0)
    assert "is no folder" in found.error


def test_names_differ_and_stay_and_are_no_paths(tmp_path):
    sources = [tmp_path / place for place in ("x/drive", "y/drive", "y/Drive", "x/.batch", "z/run")]
    first = [each.name for each in open_recordings(sources, {})]
    assert first == ["drive", "y-drive", f"{tmp_path.name}-y-Drive", "batch", "run"]
    known = dict(zip(map(str, sources), first, strict=True))
    again = open_recordings([tmp_path / "w/drive", *reversed(sources)], known)
    assert [each.name for each in again] == ["w-drive", *reversed(first)]


def test_names_are_numbered_where_folders_do_not_tell_them_apart(tmp_path):
    names = [f"{'-'.join(tmp_path.parts[k:])}-drive" for k in range(1, len(tmp_path.parts))]
    taken = {f"/old/{k}": name for k, name in enumerate(["drive", *names])}
    assert open_recordings([tmp_path / "drive"], taken)[0].name == "drive-2"


def test_the_longest_is_first_and_equal_ones_go_by_name(tmp_path):
    sizes = {"a": 3, "c": 7, "b": 7, "d": 0}
    found = [Recording(name, tmp_path / name, name, 1, size) for name, size in sizes.items()]
    assert [each.name for each in longest_first(found)] == ["b", "c", "a", "d"]
