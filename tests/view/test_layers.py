"""What a map and a frame can be coloured by."""

from dataclasses import replace

import numpy as np
import pytest
from view_maps import no_response, three_vertices, wall

from tspslam.view._layers import BARE, colours_of, layers_of_frame, layers_of_map, steps_of, table, ticks_of

OF_A_MAP = ["face_signal", "edge_signal", "vertex_signal", "magnitude", "direction", "depth", "face_views",
            "edge_views", "face_spread"]  # fmt: skip


def by_name(layers):
    return {layer.name: layer for layer in layers}


def count(shown, level):
    complex_ = shown.complex_
    return {"vertex": complex_.n, "edge": len(complex_.edges), "face": len(complex_.faces)}[level]


@pytest.mark.parametrize("of_map", [True, False])
def test_each_element_of_a_level_has_a_value_or_is_marked(frame, of_map):
    shown = wall() if of_map else frame
    for layer in (layers_of_map if of_map else layers_of_frame)(shown):
        n = count(shown, layer.level)
        assert len(layer.values) == len(layer.ok) == len(colours_of(layer)) == n
        assert np.isfinite(layer.values).all()
        assert layer.span[0] < layer.span[1]
        assert layer.note.endswith((".", "+."))


def test_a_map_has_a_layer_for_all_that_it_knows():
    assert [layer.name for layer in layers_of_map(wall())] == OF_A_MAP


def test_regions_come_first():
    rgb = np.random.default_rng(0).random((len(wall().surface.faces), 3))
    first = layers_of_map(wall(), rgb)[0]
    assert first.name == "regions"
    np.testing.assert_array_equal(colours_of(first), np.rint(255 * rgb).astype(np.uint8))


def test_what_is_not_there_is_no_layer():
    assert {"magnitude", "direction"}.isdisjoint(by_name(layers_of_map(no_response())))


def test_a_marked_element_has_the_colour_of_none():
    map_ = wall()
    ok = map_.signals.face_ok.copy()
    ok[3] = False
    layer = by_name(layers_of_map(replace(map_, signals=replace(map_.signals, face_ok=ok))))["face_signal"]
    np.testing.assert_array_equal(colours_of(layer)[3], BARE)
    assert not (colours_of(layer)[ok] == BARE).all(axis=1).any()


def test_steps_go_from_one_end_of_the_scale_to_the_other():
    for layer in layers_of_map(wall()):
        if layer.scale == "rgb":
            continue
        share = (layer.values - layer.span[0]) / (layer.span[1] - layer.span[0])
        inside = layer.ok & (share >= 0) & (share <= 1)
        assert np.abs(steps_of(layer)[inside] / 255 - share[inside]).max() <= 0.5 / 255 + 1e-12
        assert (steps_of(layer)[layer.ok & (share > 1)] == 255).all()


def test_depth_is_along_the_axis_of_the_best_view():
    map_ = wall()
    view = np.ones(len(map_), np.int32)
    depth = by_name(layers_of_map(replace(map_, best_view=map_.best_view._replace(vertex=view))))["depth"]
    np.testing.assert_allclose(depth.values, map_.xyz[:, 2] - 0.4)


def test_counts_of_views_have_whole_numbers_beside_their_scale():
    words = [words for _, words in ticks_of(by_name(layers_of_map(wall()))["face_views"])]
    assert words == sorted({*words}, key=float)
    assert all(float(word).is_integer() for word in words)


def test_ticks_stand_on_their_values():
    for layer in layers_of_map(wall()):
        for place, words in ticks_of(layer):
            assert -1e-9 <= place <= 1 + 1e-9
            value = layer.span[0] + place * (layer.span[1] - layer.span[0])
            assert float(words) == pytest.approx(10**value if layer.is_log else value, rel=6e-3, abs=1e-3)


def test_the_scale_of_phases_has_no_seam():
    rgb = table("phase").astype(int)
    steps = np.abs(np.diff(np.vstack([rgb, rgb[:1]]), axis=0)).sum(axis=1)
    assert steps[-1] <= steps[:-1].max()


def test_colours_of_a_signal_with_three_channels_are_its_own(build):
    layer = by_name(layers_of_frame(build(channels=3)))["face_signal"]
    assert layer.scale == "rgb"
    assert not ticks_of(layer)


def test_a_map_of_one_face_has_layers():
    assert "face_signal" in by_name(layers_of_map(three_vertices()))


def test_layers_of_odd_frames_are_finite(odd_frame):
    for layer in layers_of_frame(odd_frame):
        assert np.isfinite(layer.values[layer.ok]).all()
        assert np.isfinite(layer.span).all()
        assert len(colours_of(layer)) == count(odd_frame, layer.level)


def test_a_denoised_map_has_its_luminance_as_measured_on_the_same_scale():
    before = wall()
    noisy = replace(
        before.signals, face=before.signals.face + np.where(np.arange(len(before.signals.face)) % 2, 0.3, 0)
    )
    found = by_name(layers_of_map(before, before=replace(before, signals=noisy)))
    measured, denoised = found["face_signal_before"], found["face_signal"]
    assert measured.span == denoised.span
    np.testing.assert_array_equal(measured.values, noisy.face)
    assert {"edge_signal_before", "vertex_signal_before"} <= found.keys()
    assert "magnitude_before" not in found
