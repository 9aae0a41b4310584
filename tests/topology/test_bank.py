import numpy as np
import pytest

from tspslam import InputError, Response, build_complex, chf, chf_bank, sample_signals, tmahf, tmahf_bank

from .scenes import noise, scattered

UV, COMPLEX = scattered(60)
MARKED = np.where(np.arange(60)[:, None] % 13 == 5, np.nan, UV)
SIGNALS = sample_signals(noise(), MARKED, COMPLEX)
COLOUR = sample_signals(noise((40, 60, 3)), UV, COMPLEX, channels="all")


@pytest.mark.parametrize("centering", ["none", "mean", "harmonic"])
@pytest.mark.parametrize("rings", [1, 2, 3])
def test_a_bank_holds_the_single_responses(centering, rings):
    orders = (3, 0, 1, 2, 1)
    bank = tmahf_bank(COMPLEX, MARKED, SIGNALS, orders, (rings,), centering=centering)
    for k, order in enumerate(orders):
        mode = centering if order else "none"
        one = tmahf(COMPLEX, MARKED, SIGNALS, order=order, centering=mode, weight=lambda d: float(d <= rings))
        np.testing.assert_allclose(bank[k].z, one.z, atol=1e-12)
        np.testing.assert_array_equal(bank[k].defined, one.defined)
        assert bank[k].order == order


def test_scales_come_one_after_another_and_channels_are_filtered_alike():
    bank = tmahf_bank(COMPLEX, UV, COLOUR, (1, 2), (2, 1))
    assert bank.z.shape == (60, 4, 3)
    assert (bank.orders.tolist(), bank.scales.tolist(), len(bank)) == ([1, 2, 1, 2], [2, 2, 1, 1], 4)
    for k, (order, rings) in enumerate([(1, 2), (2, 2), (1, 1), (2, 1)]):
        one = tmahf(COMPLEX, UV, COLOUR, order=order, weight=lambda d, rings=rings: float(d <= rings))
        np.testing.assert_allclose(bank[k].z, one.z, atol=1e-12)
    np.testing.assert_array_equal(bank.magnitude, np.abs(bank.z))
    np.testing.assert_array_equal(bank.phase[:, 1], bank[1].phase)


def test_edges_without_a_face_take_part_in_banks_as_in_single_filters():
    complex_ = build_complex(COMPLEX.faces[:20], 60, edges=[[0, 59], [3, 41]])
    signals = sample_signals(noise(), UV, complex_)
    bank = tmahf_bank(complex_, UV, signals, (1,), (1, 2))
    for k in range(2):
        one = tmahf(complex_, UV, signals, weight=lambda d, k=k: float(d <= k + 1))
        np.testing.assert_allclose(bank[k].z, one.z, atol=1e-12)


def test_steering_is_turning_the_filter():
    uv, angle = UV, 0.7
    for order in (1, 2, 3):
        response = tmahf(COMPLEX, uv, SIGNALS, order=order, centering="none")
        c, s = np.cos(angle), np.sin(angle)
        turned = uv @ np.array([[c, -s], [s, c]])  # the image turned back by the angle
        places = {name: getattr(SIGNALS, name) @ np.array([[c, -s], [s, c]]) for name in ("edge_uv", "face_uv")}
        moved = tmahf(COMPLEX, turned, type(SIGNALS)(**(vars(SIGNALS) | places)), order=order, centering="none")
        np.testing.assert_allclose(response.steer(angle), moved.z.real, atol=1e-10)
        np.testing.assert_allclose(response.steer(response.phase / order), response.magnitude, atol=1e-12)


def test_a_direction_for_each_vertex_and_channels_can_be_steered():
    response = tmahf(COMPLEX, UV, COLOUR)
    angles = np.linspace(0, 3, 60)
    expected = np.stack([response.steer(a)[i] for i, a in enumerate(angles)])
    np.testing.assert_allclose(response.steer(angles), expected)
    with pytest.raises(InputError, match=r"angle has shape \(3,\), expected one finite angle or one for each vertex"):
        response.steer(np.zeros(3))
    with pytest.raises(InputError, match="expected one finite angle"):
        Response(np.zeros(1, complex), 1, np.ones(1, bool)).steer(np.nan)


def by_hand(image, order, sigma, v, u, reach):
    dv, du = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    weight = np.exp(-(du**2 + dv**2) / (2 * sigma**2))
    harmonic = np.exp(1j * order * np.arctan2(dv, du))
    harmonic[reach, reach] = order == 0
    return (weight / weight.sum() * harmonic * image[v - reach : v + reach + 1, u - reach : u + reach + 1]).sum()


@pytest.mark.parametrize("order", [0, 1, 2, 4])
@pytest.mark.parametrize("scale", [0.6, 1.5, 3.0])
def test_the_circular_harmonic_filter_is_its_sum(order, scale):
    image = noise((40, 60), dtype=np.float64)
    got, reach = chf(image, order, scale), int(np.ceil(4 * scale))
    assert got.z.shape == (40, 60)
    for v, u in ((15, 20), (20, 30), (22, 41)):
        assert got.z[v, u] == pytest.approx(by_hand(image, order, scale, v, u, reach), abs=1e-12)


def test_constants_have_no_harmonics_and_ramps_have_their_direction():
    np.testing.assert_allclose(chf(np.full((9, 12), 0.7), 1).z, 0, atol=1e-14)
    np.testing.assert_allclose(chf(np.full((9, 12), 0.7), 0).z, 0.7, atol=1e-14)
    v, u = np.mgrid[:50, :50]
    for angle in (-2.5, -1.0, 0.0, 0.3, 2.0):
        ramp = 0.5 + (np.cos(angle) * u + np.sin(angle) * v) / 200
        assert chf(ramp).phase[25, 25] == pytest.approx(angle, abs=1e-9)


def test_a_bank_of_an_image_holds_its_single_filters_and_small_images_are_mirrored():
    image = noise((7, 5))
    bank = chf_bank(image, (1, 2), (1.0, 3.0))
    assert (bank.z.shape, bank.defined.all(), bank.scales.tolist()) == ((7, 5, 4), True, [1, 1, 3, 3])
    for k in range(4):
        one = chf(image, int(bank.orders[k]), float(bank.scales[k]))
        np.testing.assert_allclose(bank[k].z, one.z, atol=1e-12)


@pytest.mark.parametrize(("call", "message"), [
    (lambda: tmahf_bank(COMPLEX, UV, SIGNALS, (), (1,)), "0 orders and 1 scales, expected at least one"),
    (lambda: tmahf_bank(COMPLEX, UV, SIGNALS, 1), "orders, scales are 1, .*, expected sequences"),
    (lambda: tmahf_bank(COMPLEX, "abc", SIGNALS), "uv is <U3"),
    (lambda: tmahf_bank(COMPLEX, [[1, 2], [3]], SIGNALS), "uv has rows of different lengths"),
    (lambda: tmahf(COMPLEX, UV, SIGNALS).steer("a"), "angle is <U1"),
    (lambda: sample_signals(noise(), [[1, 2], [3]], COMPLEX), "uv has rows of different lengths"),
    (lambda: tmahf_bank(COMPLEX, UV, SIGNALS, (1,), (0,)), "scale is 0, expected a number of rings"),
    (lambda: tmahf_bank(COMPLEX, UV, SIGNALS, (1,), (1.5,)), r"scale is 1\.5"),
    (lambda: tmahf_bank(COMPLEX, UV, SIGNALS, (-1,)), "order is -1"),
    (lambda: tmahf_bank(COMPLEX, UV, SIGNALS, centering="plane"), "centering of a bank is 'plane'"),
    (lambda: chf(noise(), order=1.5), r"chf: order is 1\.5"),
    (lambda: chf(noise(), scale=0), "scale is 0, expected a finite number >= 0.1"),
    (lambda: chf(noise(), scale=1e5), "is too large for a scale of 1"),
    (lambda: chf_bank(noise(), scales=()), "3 orders and 0 scales"),
    (lambda: chf(np.zeros((3, 3, 2))), "has 2 channels"),
])  # fmt: skip
def test_bad_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_banks_too_large_for_memory_are_refused(monkeypatch):
    monkeypatch.setattr("tspslam.topology.harmonic.LARGEST_BANK", 100)
    with pytest.raises(InputError, match="tmahf: responses take"):
        tmahf_bank(COMPLEX, UV, SIGNALS)
    with pytest.raises(InputError, match="chf: responses take"):
        chf(noise())
