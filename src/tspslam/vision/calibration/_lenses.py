"""Formulas of the lens models: a ray meets a plane, the plane is bent, its points become pixels.

Every model maps a ray (X, Y, Z) to ``(x, y) = (X, Y) / n(X, Y, Z)``, with an n of its own; Brown's family and Mei's
model bend (x, y) besides. Rays come as unit vectors, as rows.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...types import BoolArray, Camera, FloatArray

PERSPECTIVE = ("brown", "rational", "thin_prism")
"""Lenses whose plane is that of a pinhole: they see nothing behind it."""

NEGLIGIBLE = 1e-9
"""Of a coefficient: what is closer to 0 has no say in where a distortion turns back."""

_ROUNDING = 1e-12  # of cosines, so that a ray on the border of a lens is not lost by it
_NEAR_AXIS = 1e-9  # of the sine to a ray: closer, an equidistant lens is a pinhole to the last digit
_SHORT_OF_POLE = 1 - 1e-9  # of its radius: there, the image is 1e9 focal lengths away
_STEPS = 100  # of a search that halves an interval at worst
_EXACT = 1e-15  # of a root, by its size
_SOLVED = 1e-12  # of what is left on the plane, by the size of what was looked for
_NEWTON_STEPS = 30  # it takes 5 where a lens is a lens
_HALVINGS = 6  # of a step of Newton's that makes things worse

Divisor = tuple[FloatArray, FloatArray, BoolArray]  # n, its derivatives by X, Y, Z, and whether the lens sees the ray
Plane = tuple[FloatArray, FloatArray]


def divide(camera: Camera, rays: FloatArray) -> Divisor:
    """Return n of unit rays (N,), its gradient (N, 3), and which of them the lens sees."""
    if camera.lens == "equidistant":
        return _divide_equidistant(camera, rays)
    return _DIVISORS[camera.lens](camera, rays)


def _divide_pinhole(camera: Camera, rays: FloatArray) -> Divisor:
    n = rays[:, 2]
    return n, np.broadcast_to((0.0, 0.0, 1.0), rays.shape), n > 0


def _divide_mei(camera: Camera, rays: FloatArray) -> Divisor:
    xi, z = camera.distortion[0], rays[:, 2]
    n = z + xi
    return n, xi * rays + (0.0, 0.0, 1.0), (n > 0) & (1 + xi * z >= -_ROUNDING)


def _divide_eucm(camera: Camera, rays: FloatArray) -> Divisor:
    alpha, beta = camera.distortion
    scaled = rays * (beta, beta, 1.0)
    rho = np.sqrt((rays * scaled).sum(axis=1))
    n, gradient = alpha * rho + (1 - alpha) * rays[:, 2], alpha * scaled / rho[:, None] + (0.0, 0.0, 1 - alpha)
    return n, gradient, (n > 0) & ((1 - alpha) * rho + alpha * rays[:, 2] >= -_ROUNDING * rho)


def _divide_double_sphere(camera: Camera, rays: FloatArray) -> Divisor:
    xi, alpha = camera.distortion
    z = rays[:, 2] + xi
    shifted = np.column_stack([rays[:, :2], z])
    length = np.sqrt((shifted * shifted).sum(axis=1))
    n = alpha * length + (1 - alpha) * z
    by_z = xi * rays + (0.0, 0.0, 1.0)  # derivatives of z
    by_length = (rays * (1.0, 1.0, 0.0) + z[:, None] * by_z) / np.where(length > 0, length, 1.0)[:, None]
    sees = (n > 0) & ((1 - alpha) * length + alpha * z >= -_ROUNDING * length) & (1 + xi * rays[:, 2] >= -_ROUNDING)
    return n, alpha * by_length + (1 - alpha) * by_z, sees


def _divide_equidistant(camera: Camera, rays: FloatArray) -> Divisor:
    sine, z = np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]
    theta = np.arctan2(sine, z)
    bent, slope = _bend_angle(camera, theta)
    off_axis = sine > _NEAR_AXIS
    safe = np.where(off_axis, bent, 1.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        n = np.where(off_axis, sine / safe, z)
        by_sine = np.where(off_axis, (bent - sine * slope * z) / safe**2, 0.0)
        by_z = np.where(off_axis, sine * sine * slope / safe**2, 1.0)
    around = by_sine / np.where(off_axis, sine, 1.0)
    gradient = np.column_stack([around * rays[:, 0], around * rays[:, 1], by_z])
    return n, gradient, (theta <= widest_angle(camera)) & (n > 0)


_DIVISORS: dict[str, Callable[[Camera, FloatArray], Divisor]] = {
    **dict.fromkeys(PERSPECTIVE, _divide_pinhole),
    "mei": _divide_mei,
    "eucm": _divide_eucm,
    "double_sphere": _divide_double_sphere,
}


def lift(camera: Camera, x: FloatArray, y: FloatArray) -> FloatArray:
    """Rays (N, 3), of any length, that meet the plane at (x, y) before it is bent; NaN where there is none."""
    if camera.lens == "equidistant":
        return _lift_equidistant(camera, x, y)
    return _LIFTS[camera.lens](camera, x, y)


def _lift_pinhole(camera: Camera, x: FloatArray, y: FloatArray) -> FloatArray:
    return np.column_stack([x, y, np.ones_like(x)])


def _lift_mei(camera: Camera, x: FloatArray, y: FloatArray) -> FloatArray:
    return _lift_sphere(camera.distortion[0], x, y, np.ones_like(x))


def _lift_eucm(camera: Camera, x: FloatArray, y: FloatArray) -> FloatArray:
    alpha, beta = camera.distortion
    return np.column_stack([x, y, _height(alpha, beta * (x * x + y * y))])


def _lift_double_sphere(camera: Camera, x: FloatArray, y: FloatArray) -> FloatArray:
    xi, alpha = camera.distortion
    return _lift_sphere(xi, x, y, _height(alpha, x * x + y * y))


def _height(alpha: float, rr: FloatArray) -> FloatArray:
    """Z of the ray (x, y, Z) that alpha's mixture of a sphere and a plane has at the squared radius rr."""
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1 - (2 * alpha - 1) * rr)
    return np.asarray((1 - alpha * alpha * rr) / (alpha * root + 1 - alpha))


def _lift_sphere(xi: float, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """From rays of a centre that is xi behind that of a unit sphere: the far one of two points of the sphere."""
    rr = x * x + y * y
    with np.errstate(invalid="ignore"):
        scale = (z * xi + np.sqrt(z * z + (1 - xi * xi) * rr)) / (z * z + rr)
    return np.column_stack([scale * x, scale * y, scale * z - xi])


def _lift_equidistant(camera: Camera, x: FloatArray, y: FloatArray) -> FloatArray:
    radius = np.hypot(x, y)
    theta = solve_rising(lambda angle: _bend_angle(camera, angle), radius, widest_angle(camera))
    scale = np.sin(theta) / np.where(radius > 0, radius, 1.0)
    return np.column_stack([scale * x, scale * y, np.cos(theta)])


_LIFTS: dict[str, Callable[[Camera, FloatArray, FloatArray], FloatArray]] = {
    **dict.fromkeys(PERSPECTIVE, _lift_pinhole),
    "mei": _lift_mei,
    "eucm": _lift_eucm,
    "double_sphere": _lift_double_sphere,
}


def _bend_angle(camera: Camera, theta: FloatArray) -> Plane:
    """Kannala and Brandt's radius at an angle from the axis, and its slope."""
    k1, k2, k3, k4 = camera.distortion
    tt = theta * theta
    bent = theta * (1 + tt * (k1 + tt * (k2 + tt * (k3 + tt * k4))))
    return bent, 1 + tt * (3 * k1 + tt * (5 * k2 + tt * (7 * k3 + tt * 9 * k4)))


def widest_angle(camera: Camera) -> float:
    """Angle from the axis up to which the radius of an equidistant lens grows, rad."""
    k1, k2, k3, k4 = _weighty(camera.distortion)
    return min(np.pi, _first_root([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0]))


def is_bent(camera: Camera) -> bool:
    """Whether the plane of this lens is bent."""
    return camera.lens in PERSPECTIVE or camera.lens == "mei"


def bend(camera: Camera, x: FloatArray, y: FloatArray) -> Plane:
    """Where the points (x, y) of the plane go, by the distortion of Brown's family."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = _coefficients(camera)
    rr = x * x + y * y
    radial = 1 + rr * (k1 + rr * (k2 + rr * k3))
    if k4 or k5 or k6:
        with np.errstate(divide="ignore", invalid="ignore"):  # where the lens has a pole it has no image
            radial = radial / (1 + rr * (k4 + rr * (k5 + rr * k6)))
    x, y = x * radial + 2 * p1 * x * y + p2 * (rr + 2 * x * x), y * radial + p1 * (rr + 2 * y * y) + 2 * p2 * x * y
    if s1 or s2 or s3 or s4:
        x, y = x + rr * (s1 + rr * s2), y + rr * (s3 + rr * s4)
    return x, y


def bend_slopes(camera: Camera, x: FloatArray, y: FloatArray) -> FloatArray:
    """Derivatives of `bend`, (N, 2, 2): [[xx, xy], [yx, yy]]."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = _coefficients(camera)
    rr = x * x + y * y
    above, below = 1 + rr * (k1 + rr * (k2 + rr * k3)), 1 + rr * (k4 + rr * (k5 + rr * k6))
    above_slope, below_slope = k1 + rr * (2 * k2 + rr * 3 * k3), k4 + rr * (2 * k5 + rr * 3 * k6)
    radial, slope = above / below, (above_slope * below - above * below_slope) / below**2  # the slope by r²
    prism_x, prism_y = 2 * (s1 + 2 * s2 * rr), 2 * (s3 + 2 * s4 * rr)
    xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_x * x
    xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y + prism_x * y
    yx = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y + prism_y * x
    yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_y * y
    return np.stack([np.stack([xx, xy], axis=-1), np.stack([yx, yy], axis=-1)], axis=-2)


def _coefficients(camera: Camera) -> tuple[float, ...]:
    """k1, k2, p1, p2, k3 to k6, s1 to s4, with 0 for those that the lens lacks."""
    given = camera.distortion[1:] if camera.lens == "mei" else camera.distortion
    return (*given, *(0.0,) * 8)[:12]


def turning_radius(camera: Camera) -> float:
    """Radius on the plane where the radial distortion of Brown's family turns back, or has a pole; inf for nowhere."""
    k1, k2, _, _, k3, k4, k5, k6, *_ = _weighty(_coefficients(camera))
    above, below = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])  # in r²
    rising = above * below + np.poly1d([2.0, 0.0]) * (above.deriv() * below - above * below.deriv())
    return min(_first_root(rising.coeffs), _first_root(below.coeffs) * _SHORT_OF_POLE)


def _weighty(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(k if abs(k) > NEGLIGIBLE else 0.0 for k in coefficients)


def _first_root(polynomial: FloatArray | list[float]) -> float:
    """Root of the smallest positive real square of a polynomial in the square; inf if none."""
    roots = np.roots(polynomial)
    found = np.sqrt(roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)].real)
    return float(found.min()) if len(found) else np.inf


def is_ahead(camera: Camera, x: FloatArray, y: FloatArray) -> BoolArray:
    """Whether points of the plane lie before the distortion turns back: nearer, and not turned over."""
    slopes = bend_slopes(camera, x, y)
    area = slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0]
    return np.asarray((x * x + y * y <= turning_radius(camera) ** 2 * (1 + _ROUNDING)) & (area > -_ROUNDING))


def unbend(camera: Camera, x: FloatArray, y: FloatArray) -> Plane:
    """Points of the plane that `bend` brings to (x, y); NaN where none is."""
    radius = np.hypot(x, y)
    flat = solve_rising(lambda r: bend_radius(camera, r), radius, turning_radius(camera))
    scale = np.where(np.isfinite(flat), flat, radius) / np.where(radius > 0, radius, 1.0)
    wanted = np.column_stack([x, y])
    found = _solve_newton(camera, wanted, wanted * scale[:, None])
    left = np.abs(np.column_stack(bend(camera, *found.T)) - wanted).max(axis=1, initial=0.0)
    good = (left <= _SOLVED * (1 + np.abs(wanted).max(axis=1, initial=0.0))) & is_ahead(camera, *found.T)
    found[~good] = np.nan
    return found[:, 0], found[:, 1]


def bend_radius(camera: Camera, r: FloatArray) -> Plane:
    """Radius after the radial distortion alone, and its slope."""
    k1, k2, _, _, k3, k4, k5, k6, *_ = _coefficients(camera)
    rr = r * r
    above, below = 1 + rr * (k1 + rr * (k2 + rr * k3)), 1 + rr * (k4 + rr * (k5 + rr * k6))
    above_slope, below_slope = k1 + rr * (2 * k2 + rr * 3 * k3), k4 + rr * (2 * k5 + rr * 3 * k6)
    return r * above / below, above / below + 2 * rr * (above_slope * below - above * below_slope) / below**2


def _solve_newton(camera: Camera, wanted: FloatArray, start: FloatArray) -> FloatArray:
    """Points (N, 2) whose bent place is the wanted one, from a start; a step that makes things worse is halved."""
    found, rows = start.copy(), np.arange(len(start))
    left = _left(camera, found, wanted)
    for _ in range(_NEWTON_STEPS):
        rows = rows[left[rows] > 0]
        if len(rows) == 0:
            break
        tried, error = _search_along(camera, found[rows], wanted[rows])
        better = error < left[rows]
        rows = rows[better]
        found[rows], left[rows] = tried[better], error[better]
    return found


def _search_along(camera: Camera, points: FloatArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """After a step of Newton's, halved until it is nearer, and what is left then."""
    step, before = _newton_step(camera, points, wanted), _left(camera, points, wanted)
    tried = points + step
    error = _left(camera, tried, wanted)
    for _ in range(_HALVINGS):
        worse = np.flatnonzero(~(error < before))
        step[worse] /= 2
        tried[worse] = points[worse] + step[worse]
        error[worse] = _left(camera, tried[worse], wanted[worse])
    return tried, error


def _left(camera: Camera, points: FloatArray, wanted: FloatArray) -> FloatArray:
    x, y = bend(camera, *points.T)
    return np.hypot(x - wanted[:, 0], y - wanted[:, 1])


def _newton_step(camera: Camera, points: FloatArray, wanted: FloatArray) -> FloatArray:
    off = wanted - np.column_stack(bend(camera, *points.T))
    slopes = bend_slopes(camera, *points.T)
    (a, b), (c, d) = slopes[:, 0].T, slopes[:, 1].T
    area = a * d - b * c
    return np.column_stack([(d * off[:, 0] - b * off[:, 1]) / area, (a * off[:, 1] - c * off[:, 0]) / area])


def solve_rising(function: Callable[[FloatArray], Plane], values: FloatArray, end: float) -> FloatArray:
    """Where a function that rises from 0 over [0, end] has given values; NaN where it has them not.

    `function` also returns its slope: Newton's method, inside an interval that shrinks about the root.
    """
    with np.errstate(all="ignore"):
        low, high = np.zeros_like(values), _upper(function, values, end)
        reached = values <= function(high)[0] * (1 + _ROUNDING)
        root = np.clip(values, low, high)
        for _ in range(_STEPS):
            value, slope = function(root)
            under = value < values
            low, high = np.where(under, root, low), np.where(under, high, root)
            step = root - (value - values) / slope
            following = np.where((step >= low) & (step <= high), step, (low + high) / 2)
            if (np.abs(following - root) <= _EXACT * root).all():
                break
            root = following
    return np.where(reached & np.isfinite(values), root, np.nan)


def _upper(function: Callable[[FloatArray], Plane], values: FloatArray, end: float) -> FloatArray:
    """Ends of the intervals to search: `end`, or where that is infinite, what lies beyond the values."""
    if np.isfinite(end):
        return np.full_like(values, end)
    high = np.maximum(values, 1e-300)
    for _ in range(_STEPS):
        short = function(high)[0] < values
        if not short.any():
            break
        high = np.where(short, 2 * high, high)
    return high
