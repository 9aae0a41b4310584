"""What a run warns of, with what to do, and why it is not complete."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ._html import text

ADVICE = {
    "apart": "Nothing is to be done: they came before the place was known; the rest of the recording is joined.",
    "adjustment": "Drive slower or with more overlap there; single cases are harmless, many make the path drift.",
    "bits": "If the pictures look too dark or too bright, say how many bits your camera writes: --bits 12, say.",
    "calibration": "Look at your calibration file with tspslam calib show: it prints where each value is from.",
    "camera_lost": "Look at the cable, and at other programs that use the camera; the recording has all that it gave.",
    "depth_clock": "Synchronise colour and depth, or move slower: their edges differ where the camera moves.",
    "depth_empty": "Look at those depth files: the frames are placed by others alone, and add no points.",
    "depth_flying": "Say which sensor it is (--sensor), and check that depths and images are of the same pixels.",
    "depth_holes": "Go nearer, or out of the sun: there are points only where there are depths.",
    "depth_range": "Check --unit (0.001 reads millimetres), and say which sensor it is (--sensor).",
    "depth_sensor": "Say which sensor it is (--sensor): depths that are believed too much bend the path.",
    "disparity_offset": (
        "Calibrate the pair anew, or check that the calibration belongs to these images and to their size; "
        "--fix-offset takes it off points and responses too."
    ),
    "equal_stamps": "Check the clock or the file of stamps of your recording: each pair needs a time of its own.",
    "few_points": (
        "Look at these frames below: more light or a shorter exposure helps, or more keypoints "
        "(--set detector.count=4000), or --bits."
    ),
    "focal_length": "Check that the calibration is of these images and of their size, and calibrate anew if it is.",
    "frame_skipped": "Look at these image files: they are missing, damaged, or of another size than the others.",
    "frames_dropped": "Run the recording, which has all pairs; smaller images or fewer a second let tracking keep up.",
    "frames_missed": "Record smaller images, fewer a second, or to a faster disk.",
    "images_forgotten": (
        "Make room where temporary files go (TMPDIR names another place), or give images of old keyframes more memory."
    ),
    "join_left_out": "Mend or run anew what the line names, and join again: the map is without it.",
    "join_refused": (
        "Nothing is to be done where two places look alike; where the runs do share one, join a further run that "
        "passes it and a place of the others."
    ),
    "map": "The path is there without a map: let keyframes overlap more, or take a longer piece of the sequence.",
    "map_parts": (
        "Trust each part by itself, not where parts stand to one another; a slower pass over the gap joins them."
    ),
    "mesh": "Mend the mesh in the program that it comes from, then filter it again.",
    "no_complex": "The frame shows too little for a surface: nothing is to be done for single frames without texture.",
    "no_response": "Check that the mesh or the points lie in view of the camera, and that faces share vertices.",
    "no_shared_edge": "Filter it again with --merge-corners, or join the vertices in the program that made the mesh.",
    "not_joined": (
        "Let the recording pass a place that the others saw, in the same direction; its own path is in its own file."
    ),
    "offset_unexplained": "Calibrate the pair anew; if it was knocked, run what is before and what is after.",
    "offsets_differ": "Run each recording by itself, with its own calibration: this run takes no offset off either.",
    "polygons": "Nothing is to be done; cut the faces yourself where another diagonal would be better.",
    "repeated_corners": "Filter it again with --merge-corners, so that what touches is joined.",
    "scan_dropped": "Nothing is to be done for beams that met nothing; else look at what wrote the scan.",
    "scan_far": "Write the scan in metres, in the scanner's own frame: that of a map, or millimetres, is neither.",
    "scan_outside": "Check --extrinsics: it takes points from the scanner's frame to the camera's, in metres.",
    "surface": "Nothing is to be done for a few frames; else choose the plain surface: --set surface.kind=delaunay.",
    "thin_map": "Let the camera see places more than once, from nearby: a slower pass, or more frames a second.",
    "tracking_lost": (
        "Look at these frames in the gallery: fast turns, blur and bare walls are usual causes; more frames "
        "a second or a slower pass help."
    ),
    "truth": "Check that the true poses belong to this sequence: as many lines as frames, or stamps of the same clock.",
    "two_motions": (
        "Look at these frames in the gallery: does a vehicle fill most of the view? Start where it does not, or cut "
        "them out; the poses' covariances are wide there."
    ),
    "unknown": "If your map uses another value for 'not known', name it with --unknown.",
    "unpaired": "Check that each left image has a right one; images without a partner are left out.",
    "vertical_offset": "Calibrate anew, or give the file that these images were rectified by; fix loose cameras.",
    "video_cut": "Copy the video again, if the original is whole; the frames that are there were taken.",
    "video_frozen": "Copy the file anew: frames that are damaged are shown as those before them.",
    "video_turned": "Calibrate with frames of such a video: the calibration must be of the turned images.",
    "unseen_vertices": "Check the pose of the mesh in the camera's frame, if more is hidden than you expect.",
}
"""What to do about each warning that a run can give, by its code."""
REASONS = {
    "camera_lost": "the camera gave no more images",
    "frame_skipped": "pairs could not be used",
    "tracking_lost": "tracking was lost",
    "join_left_out": "runs that were to be joined were left out",
    "not_joined": "a recording was not found in the map of the others",
    "apart": "frames of a recording stand nowhere in its path",
    "no_complex": "frames have a pose, but no surface",
    "adjustment": "adjustments of the map had no solution",
    "no_response": "no vertex has a response",
    "map": "there is no map of all keyframes",
    "no_shared_edge": "the faces of the mesh share no edge",
}
"""Why a run is degraded, by the code of the warning that says so."""
MOST_OF_A_KIND = 5  # messages of one code that are shown


def warnings_section(warnings: Any) -> str:
    """Make the section of warnings, those of one code together with what to do; nothing where there are none."""
    kinds = _by_code(warnings)
    if not kinds:
        return ""
    items = "".join(_item(code, messages) for code, messages in kinds.items())
    return (
        '<section class="warnings" aria-labelledby="warnings"><h2 id="warnings">Warnings, and what to do</h2>'
        f"<ul>{items}</ul></section>"
    )


def why_degraded(run: Mapping[str, Any]) -> str:
    """Say in a sentence why a run is not complete; nothing of one that is, or where that is not known."""
    if run.get("status") == "complete":
        return ""
    codes = _by_code(run.get("warnings") or [])
    said = [words for code, words in REASONS.items() if code in codes]
    return f'<p class="why"><b>Not complete:</b> {text("; ".join(said))}.</p>' if said else ""


def missing_section(missing: Sequence[str]) -> str:
    """Name what could not be read."""
    if not missing:
        return ""
    items = "".join(f"<li>{text(line)}</li>" for line in missing)
    return (
        '<section class="warnings" aria-labelledby="missing"><h2 id="missing">What could not be shown</h2>'
        f"<ul>{items}</ul></section>"
    )


def _by_code(warnings: Any) -> dict[str, list[str]]:
    """Messages of each code, in order; those without a code stand alone."""
    kinds: dict[str, list[str]] = {}
    for warning in warnings if isinstance(warnings, list | tuple) else [warnings]:
        is_coded = isinstance(warning, Mapping)
        code = str(warning.get("code", "warning")) if is_coded else ""
        kinds.setdefault(code, []).append(str(warning.get("message", "") if is_coded else warning))
    return kinds


def _item(code: str, messages: list[str]) -> str:
    shown = messages[:MOST_OF_A_KIND]
    more = len(messages) - len(shown)
    lines = "".join(f"<p>{text(message)}</p>" for message in shown)
    lines += f"<p>and {more} more of this kind: run.json has them all.</p>" if more else ""
    advice = f'<p class="todo"><b>What to do:</b> {text(ADVICE[code])}</p>' if code in ADVICE else ""
    return f"<li>{f'<b>{text(code)}</b> ' if code else ''}{lines}{advice}</li>"
