"""Many views to one answer: exposures, means, variances and mean directions, beside their formulas."""

import numpy as np
import pytest

from tspslam.mapping.averaging import average, average_answers, best_rows, estimate_gains
from tspslam.mapping.sampling import Answer, Sample
from tspslam.mapping.settings import ViewSettings

SETTINGS = ViewSettings()


def samples(seed=0, elements=60, keyframes=7, share=0.5):
    rng = np.random.default_rng(seed)
    element, keyframe = np.nonzero(rng.random((elements, keyframes)) < share)
    order = np.lexsort((element, keyframe))
    size = len(order)
    return Sample(element[order], keyframe[order], rng.uniform(0.1, 0.9, size), rng.uniform(0.1, 40, size),
                  rng.uniform(0, 99, (size, 2)), rng.integers(0, 50, size).astype(np.int32))  # fmt: skip


def exposed(gain, groups, noise=0.0, elements=300):
    """Faces whose true luminance keyframes see over their gain; `groups` of keyframes see faces of their own."""
    rng = np.random.default_rng(1)
    true, rows = rng.uniform(0.2, 0.6, elements), []
    for number, group in enumerate(groups):
        mine = np.arange(number, elements, len(groups))
        rows += [(f, k) for k in sorted(group) for f in mine[rng.random(len(mine)) < 0.8]]
    element, keyframe = np.array(rows).T
    order = np.argsort(keyframe, kind="stable")
    element, keyframe = element[order], keyframe[order]
    value = true[element] / gain[keyframe] + noise * rng.normal(size=len(element))
    ones = np.ones(len(element))
    return Sample(element, keyframe, value, ones, np.zeros((len(element), 2)), ones.astype(np.int32))


@pytest.mark.parametrize("seed", range(3))
def test_means_and_variances_are_those_of_the_formula(seed):
    sample = samples(seed, share=0.25)
    gain = np.random.default_rng(seed).uniform(0.5, 2, 7)
    mean = average(sample, gain, 60)
    for i in range(60):
        mine = [r for r in range(len(sample.element)) if sample.element[r] == i]
        assert mean.views[i] == len(mine)
        if not mine:
            assert mean.value[i] == mean.variance[i] == mean.pixels[i] == 0
            assert mean.uv[i].tolist() == [0, 0]
            continue
        total = sum(sample.weight[r] for r in mine)
        seen = [gain[sample.keyframe[r]] * sample.value[r] for r in mine]
        value = sum(sample.weight[r] * s for r, s in zip(mine, seen, strict=True)) / total
        spread = sum(sample.weight[r] * (s - value) ** 2 for r, s in zip(mine, seen, strict=True)) / total
        best = max(mine, key=lambda r: sample.weight[r])
        assert mean.value[i] == pytest.approx(value, abs=1e-12)
        assert mean.variance[i] == pytest.approx(spread, abs=1e-12)
        assert mean.pixels[i] == sample.pixels[best]
        assert mean.uv[i].tolist() == sample.uv[best].tolist()
    assert (mean.views == 0).any()


def test_one_view_is_its_own_mean_without_variance():
    sample = samples(keyframes=1, share=1.0)
    mean = average(sample, np.ones(1), 60)
    assert np.array_equal(mean.value, sample.value)
    assert not mean.variance.any()


def test_equal_values_have_no_variance():
    sample = samples()._replace(value=np.full(len(samples().element), 0.3))
    mean = average(sample, np.ones(7), 60)
    assert set(mean.value[mean.views > 0]) == {0.3}
    assert not mean.variance.any()


def test_of_equal_weights_the_first_row_is_best():
    at, weight = np.array([2, 0, 2, 2, 0]), np.array([1.0, 5, 3, 3, 5])
    assert best_rows(at, weight, 4).tolist() == [1, -1, 2, -1]


GAIN = 2.0 ** np.array([0.3, -0.5, 0.1, 0.7, -0.2, -0.4, 0.5])


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_gains_recover_known_exposures(noise):
    found = estimate_gains(exposed(GAIN, [range(7)], noise), 7, SETTINGS)
    true = np.log2(GAIN) - np.log2(GAIN).mean()
    assert np.log2(found) == pytest.approx(true, abs=1e-9 if noise == 0 else 0.01)
    assert np.log(found).mean() == pytest.approx(0, abs=1e-12)


def test_each_group_of_keyframes_has_the_geometric_mean_one():
    groups = [0, 2, 5], [1, 3, 6]  # the fourth sees nothing
    found = np.log2(estimate_gains(exposed(GAIN, groups), 7, SETTINGS))
    for group in groups:
        assert found[group] == pytest.approx(np.log2(GAIN[group]) - np.log2(GAIN[group]).mean(), abs=1e-9)
    assert found[4] == 0


def test_a_fifth_of_wild_faces_does_not_move_the_gains():
    sample = exposed(GAIN, [range(7)])
    wild = (sample.element % 5 == 0) & (sample.keyframe % 2 == 0)
    found = estimate_gains(sample._replace(value=np.where(wild, 0.95, sample.value)), 7, SETTINGS)
    assert np.log2(found) == pytest.approx(np.log2(GAIN) - np.log2(GAIN).mean(), abs=0.01)


def test_few_faces_in_common_and_black_ones_say_nothing():
    few = exposed(GAIN, [range(7)], elements=15)
    assert estimate_gains(few, 7, SETTINGS).tolist() == [1] * 7
    black = exposed(GAIN, [range(7)])
    black = black._replace(value=0 * black.value)
    assert estimate_gains(black, 7, SETTINGS).tolist() == [1] * 7
    nothing = few._replace(**{name: getattr(few, name)[:0] for name in few._fields})
    assert estimate_gains(nothing, 7, SETTINGS).tolist() == [1] * 7


NORMALS = np.tile([0, 0, -1.0], (5, 1))


def answers(*given):
    """Answers of (vertex, keyframe, z, weight, angle of the tangent)."""
    vertex, keyframe, z, weight, angle = map(np.array, zip(*given, strict=True))
    direction = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return Answer(vertex, keyframe, z.astype(complex), weight.astype(float), direction)


def test_the_response_is_that_of_the_best_view_and_the_direction_the_mean():
    given = answers((1, 0, 2j, 0.5, 0.2), (3, 0, 1, 0.7, 2.0), (1, 1, 5, 0.9, 0.4), (1, 2, -1, 0.1, 0.3))
    response, best, direction, spread, count = average_answers(given, len(NORMALS), 1)
    assert best.tolist() == [-1, 1, -1, 0, -1]
    assert response.z.tolist() == [0, 5, 0, 1, 0]
    assert response.defined.tolist() == [False, True, False, True, False]
    assert count.tolist() == [0, 3, 0, 1, 0]
    summed = sum(w * np.exp(1j * a) for w, a in ((0.5, 0.2), (0.9, 0.4), (0.1, 0.3)))
    assert direction[1, :2] == pytest.approx([summed.real / abs(summed), summed.imag / abs(summed)])
    assert spread[1] == pytest.approx(np.sqrt(-2 * np.log(abs(summed) / 1.5)))
    assert direction[3] == pytest.approx([np.cos(2), np.sin(2), 0])
    assert not direction[[0, 2, 4]].any()
    assert not spread[[0, 2, 3, 4]].any()


def test_tangents_about_a_mean_have_the_spread_that_they_were_drawn_with():
    rng = np.random.default_rng(0)
    angle = rng.normal(1.0, 0.3, 4000)
    given = answers(*((0, k, 1, 1.0, a) for k, a in enumerate(angle)))
    _, _, direction, spread, _ = average_answers(given, len(NORMALS), 1)
    assert spread[0] == pytest.approx(0.3, rel=0.05)
    assert np.arctan2(direction[0, 1], direction[0, 0]) == pytest.approx(1.0, abs=0.02)


def test_tangents_that_cancel_leave_a_finite_answer():
    response, _, direction, spread, count = average_answers(
        answers((0, 0, 1, 1, 0.0), (0, 1, 3, 1, np.pi)), len(NORMALS), 1
    )
    assert np.isfinite(spread).all()
    assert np.isfinite(direction).all()
    assert np.linalg.norm(direction[0]) == pytest.approx(1)
    assert count[0] == 2
    assert response.z[0] == 1


def test_a_view_whose_response_is_nothing_points_nowhere_and_does_not_count():
    one, nothing = answers((0, 0, 1, 0.5, 0.3)), answers((0, 1, 0, 0.9, 0.0))
    nothing.direction[:] = 0
    both = Answer(*(np.concatenate(pair) for pair in zip(one, nothing, strict=True)))
    _, _, direction, spread, count = average_answers(both, len(NORMALS), 1)
    assert direction[0, :2] == pytest.approx([np.cos(0.3), np.sin(0.3)])
    assert (spread[0], count[0]) == (0, 1)
