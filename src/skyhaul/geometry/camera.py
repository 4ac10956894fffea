# SPDX-License-Identifier: Apache-2.0
"""Camera models: pinhole with radial-tangential distortion, and equidistant fisheye.

Camera axes C: x right, y down, z forward. A pixel's centre has integer coordinates: the image of
w columns spans u from -0.5 to w - 0.5, as in OpenCV. With x = X / Z, y = Y / Z, r^2 = x^2 + y^2:

    radtan:       s = 1 + k1 r^2 + k2 r^4
                  x_d = x s + 2 p1 x y + p2 (r^2 + 2 x^2),  y_d = y s + p1 (r^2 + 2 y^2) + 2 p2 x y
    equidistant:  theta = angle between the ray and z
                  theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
                  (x_d, y_d) = theta_d (X, Y) / sqrt(X^2 + Y^2)
    u = fx x_d + cx,  v = fy y_d + cy

Source: OpenCV (`projectPoints`, `fisheye`) and Kalibr (`radtan`, `equidistant`): the same maths,
coefficients in the same order.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.jit import njit
from skyhaul.params import Params
from skyhaul.types import Array, Mask

# mypy: disable-error-code="no-any-return"

RADTAN, EQUIDISTANT = 0, 1
"""Codes of `CameraArrays.model`."""

Pair = tuple[float, float]

_NEWTON_STEPS = 20
_CONVERGED = 1e-14


class CameraArrays(NamedTuple):
    """A camera model as the kernels see it."""

    model: int  # RADTAN or EQUIDISTANT
    width: int  # [px]
    height: int  # [px]
    fx: float  # [px]
    fy: float  # [px]
    cx: float  # [px]
    cy: float  # [px]
    d: Array  # (4,) distortion
    reach: float
    """Where the distortion stops growing: radtan r^2, equidistant theta [rad]. No image beyond."""


@dataclass(frozen=True, kw_only=True)
class RadTan(Params):
    """Pinhole camera with radial and tangential distortion."""

    kind: Literal["radtan"] = "radtan"
    size_px: tuple[int, int]
    """Columns and rows of the image [px]."""
    focal_px: tuple[float, float]
    """fx and fy [px]."""
    center_px: tuple[float, float]
    """Principal point, cx and cy [px]."""
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2."""

    def __post_init__(self) -> None:
        _check(self.size_px, self.focal_px)

    @classmethod
    def from_fov(
        cls,
        size_px: tuple[int, int],
        fov_deg: float,
        distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> "RadTan":
        """A camera whose middle row sees so many degrees from edge to edge; square pixels."""
        if not 0.0 < fov_deg < 180.0:
            raise ValueError(f"fov_deg must lie in (0, 180), got {fov_deg}")
        r2 = math.tan(math.radians(0.5 * fov_deg)) ** 2
        reach = _radtan_reach(distortion)
        _check_fov(fov_deg, 2.0 * math.degrees(math.atan(math.sqrt(reach))), r2 < reach)
        spread = math.sqrt(r2) * (1.0 + distortion[0] * r2 + distortion[1] * r2 * r2)
        focal_px, center_px = _centred(size_px, spread)
        return cls(size_px=size_px, focal_px=focal_px, center_px=center_px, distortion=distortion)

    def arrays(self) -> CameraArrays:
        """The model for the kernels."""
        return _arrays(RADTAN, self, _radtan_reach(self.distortion))


@dataclass(frozen=True, kw_only=True)
class Equidistant(Params):
    """Fisheye camera: the radius in the image grows with the angle from the axis."""

    kind: Literal["equidistant"] = "equidistant"
    size_px: tuple[int, int]
    """Columns and rows of the image [px]."""
    focal_px: tuple[float, float]
    """fx and fy [px per rad]."""
    center_px: tuple[float, float]
    """Principal point, cx and cy [px]."""
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """k1, k2, k3, k4."""

    def __post_init__(self) -> None:
        _check(self.size_px, self.focal_px)

    @classmethod
    def from_fov(
        cls,
        size_px: tuple[int, int],
        fov_deg: float,
        distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> "Equidistant":
        """A camera whose middle row sees so many degrees from edge to edge; square pixels."""
        if not 0.0 < fov_deg < 360.0:
            raise ValueError(f"fov_deg must lie in (0, 360), got {fov_deg}")
        theta, reach = math.radians(0.5 * fov_deg), _equidistant_reach(distortion)
        _check_fov(fov_deg, 2.0 * math.degrees(reach), theta < reach)
        k1, k2, k3, k4 = distortion
        s = theta * theta
        spread = theta * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
        focal_px, center_px = _centred(size_px, spread)
        return cls(size_px=size_px, focal_px=focal_px, center_px=center_px, distortion=distortion)

    def arrays(self) -> CameraArrays:
        """The model for the kernels."""
        return _arrays(EQUIDISTANT, self, _equidistant_reach(self.distortion))


CameraModel = RadTan | Equidistant


@njit
def project(camera: CameraArrays, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """Where a point (x, y, z) in C axes has its image: u, v [px] and whether it has one.

    The image may lie outside the frame, see `in_frame`. A point behind a pinhole camera, or
    farther out than the distortion model holds, has none.
    """
    xd, yd, ok = _distort(camera, x, y, z)
    return camera.fx * xd + camera.cx, camera.fy * yd + camera.cy, ok


@njit
def in_frame(camera: CameraArrays, u: float, v: float) -> bool:
    """Whether a place in the image plane lies on some pixel."""
    return -0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5


@njit
def unproject(camera: CameraArrays, u: float, v: float) -> tuple[float, float, float]:
    """Unit vector in C axes of the ray that has its image at u, v [px]; inverse of `project`.

    Limits: Where no ray has its image at u, v, the nearest one that the model holds for.
    """
    xd, yd = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    if camera.model == EQUIDISTANT:
        radius = math.hypot(xd, yd)
        theta = _undistorted_angle(camera, radius)
        side = math.sin(theta) / radius if radius > 1e-12 else 1.0
        return side * xd, side * yd, math.cos(theta)
    x, y = _undistorted(camera, xd, yd)
    scale = 1.0 / math.sqrt(x * x + y * y + 1.0)
    return scale * x, scale * y, scale


@njit
def project_jacobian(
    camera: CameraArrays, x: float, y: float, z: float, out: Array
) -> tuple[float, float, bool]:
    """As `project`; writes d(u, v) / d(x, y, z) into `out`, (2, 3) [px/m].

    It falls with the distance: at t times the point it is 1 / t of this. Where the point has no
    image because it lies in the plane of a pinhole, or at the origin, `out` is zero.
    """
    if z == 0.0 and (camera.model == RADTAN or (x == 0.0 and y == 0.0)):
        out[:2, :3] = 0.0
        return project(camera, x, y, z)
    if camera.model == EQUIDISTANT:
        a = _fisheye_jacobian(camera, x, y, z)
    else:
        a = _radtan_jacobian(camera, x / z, y / z, 1.0 / z)
    for c in range(3):
        out[0, c] = camera.fx * a[c]
        out[1, c] = camera.fy * a[3 + c]
    return project(camera, x, y, z)


def project_points(model: CameraModel, p_C: Array) -> tuple[Array, Mask]:
    """Images of points: (k, 3) -> (k, 2) [px] and whether each has one, (k,); see `project`."""
    points = np.ascontiguousarray(p_C, dtype=np.float64).reshape(-1, 3)
    return _project_points(model.arrays(), points)


def unproject_pixels(model: CameraModel, uv: Array) -> Array:
    """Unit rays in C axes of places in the image, (k, 2) [px] -> (k, 3); see `unproject`."""
    pixels = np.ascontiguousarray(uv, dtype=np.float64).reshape(-1, 2)
    return _unproject_pixels(model.arrays(), pixels)


def pixel_rays(model: CameraModel) -> Array:
    """Unit ray through the centre of every pixel, C axes, (height, width, 3)."""
    w, h = model.size_px
    u, v = np.meshgrid(np.arange(w, dtype=np.float64), np.arange(h, dtype=np.float64))
    return unproject_pixels(model, np.column_stack([u.ravel(), v.ravel()])).reshape(h, w, 3)


@njit
def _distort(camera: CameraArrays, X: float, Y: float, Z: float) -> tuple[float, float, bool]:
    """Distorted normalised image coordinates, and whether the model holds there."""
    d = camera.d
    if camera.model == EQUIDISTANT:
        side = math.hypot(X, Y)
        theta = math.atan2(side, Z)
        scale = _distorted_angle(camera, theta) / side if side > 1e-300 else 0.0
        return scale * X, scale * Y, theta < camera.reach and side + abs(Z) > 0.0
    if not Z > 0.0:
        return 0.0, 0.0, False
    x, y = X / Z, Y / Z
    r2 = x * x + y * y
    s = 1.0 + r2 * (d[0] + r2 * d[1])
    xd = x * s + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x)
    yd = y * s + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y
    return xd, yd, r2 < camera.reach


@njit
def _distorted_angle(camera: CameraArrays, theta: float) -> float:
    d, s = camera.d, theta * theta
    return theta * (1.0 + s * (d[0] + s * (d[1] + s * (d[2] + s * d[3]))))


@njit
def _angle_slope(camera: CameraArrays, theta: float) -> float:
    """D theta_d / d theta."""
    d, s = camera.d, theta * theta
    return 1.0 + s * (3.0 * d[0] + s * (5.0 * d[1] + s * (7.0 * d[2] + s * 9.0 * d[3])))


@njit
def _undistorted_angle(camera: CameraArrays, radius: float) -> float:
    """Theta whose theta_d is `radius`, by Newton; never beyond the model's reach."""
    theta = min(radius, camera.reach)
    for _ in range(_NEWTON_STEPS):
        slope = max(_angle_slope(camera, theta), 1e-6)
        step = (_distorted_angle(camera, theta) - radius) / slope
        theta = min(max(theta - step, 0.0), camera.reach)
        if abs(step) < _CONVERGED:
            break
    return theta


@njit
def _undistorted(camera: CameraArrays, xd: float, yd: float) -> tuple[float, float]:
    """Normalised coordinates whose distortion gives xd, yd, by Newton with the exact Jacobian."""
    x, y = xd, yd
    for _ in range(_NEWTON_STEPS):
        r2 = x * x + y * y
        if r2 > 0.999 * camera.reach:
            shrink = math.sqrt(0.999 * camera.reach / r2)
            x, y = shrink * x, shrink * y
        fx, fy, _ = _distort(camera, x, y, 1.0)
        a = _radtan_jacobian(camera, x, y, 1.0)
        det = a[0] * a[4] - a[1] * a[3]
        ex, ey = fx - xd, fy - yd
        dx, dy = (a[4] * ex - a[1] * ey) / det, (a[0] * ey - a[3] * ex) / det
        x, y = x - dx, y - dy
        if abs(dx) + abs(dy) < _CONVERGED:
            break
    return x, y


@njit
def _radtan_jacobian(
    camera: CameraArrays, x: float, y: float, inverse_z: float
) -> tuple[float, float, float, float, float, float]:
    """d(x_d, y_d) / d(X, Y, Z), row by row, at x = X/Z, y = Y/Z."""
    k1, k2, p1, p2 = camera.d[0], camera.d[1], camera.d[2], camera.d[3]
    r2 = x * x + y * y
    s = 1.0 + r2 * (k1 + r2 * k2)
    slope = 2.0 * (k1 + 2.0 * k2 * r2)
    xx = s + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    yy = s + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    i = inverse_z
    return (xx * i, xy * i, -(xx * x + xy * y) * i, xy * i, yy * i, -(xy * x + yy * y) * i)


@njit
def _fisheye_jacobian(
    camera: CameraArrays, X: float, Y: float, Z: float
) -> tuple[float, float, float, float, float, float]:
    """d(x_d, y_d) / d(X, Y, Z), row by row."""
    side2 = X * X + Y * Y
    range2 = side2 + Z * Z
    side = math.sqrt(side2)
    if side < 1e-12 * abs(Z):
        return (1.0 / Z, 0.0, 0.0, 0.0, 1.0 / Z, 0.0)
    theta = math.atan2(side, Z)
    scale = _distorted_angle(camera, theta) / side  # (x_d, y_d) = scale (X, Y)
    slope = _angle_slope(camera, theta)
    # d scale / d(X, Y, Z) = along (X, Y) and -slope / range^2
    along = (slope * Z / range2 - scale) / side2
    down = -slope / range2
    return (
        scale + along * X * X, along * X * Y, down * X,
        along * X * Y, scale + along * Y * Y, down * Y,
    )  # fmt: skip


@njit
def _project_points(camera: CameraArrays, p_C: Array) -> tuple[Array, Mask]:
    k = p_C.shape[0]
    uv, ok = np.empty((k, 2)), np.empty(k, np.bool_)
    for i in range(k):
        uv[i, 0], uv[i, 1], ok[i] = project(camera, p_C[i, 0], p_C[i, 1], p_C[i, 2])
    return uv, ok


@njit
def _unproject_pixels(camera: CameraArrays, uv: Array) -> Array:
    rays = np.empty((uv.shape[0], 3))
    for i in range(uv.shape[0]):
        rays[i, 0], rays[i, 1], rays[i, 2] = unproject(camera, uv[i, 0], uv[i, 1])
    return rays


def _centred(size_px: tuple[int, int], spread: float) -> tuple[Pair, Pair]:
    """Focal length and centre [px] of a camera whose half width spans `spread`."""
    w, h = size_px
    focal = 0.5 * w / spread
    return (focal, focal), (0.5 * (w - 1), 0.5 * (h - 1))


def _arrays(code: int, model: RadTan | Equidistant, reach: float) -> CameraArrays:
    return CameraArrays(
        code, *model.size_px, *model.focal_px, *model.center_px, np.array(model.distortion), reach
    )


def _first_root(coefficients: list[float], limit: float) -> float:
    """Smallest s in (0, limit) at which sum c_i s^i vanishes, or the limit."""
    roots = np.roots(coefficients[::-1])
    real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0.0)]
    return float(min(np.min(real, initial=limit), limit))


def _radtan_reach(k: tuple[float, float, float, float]) -> float:
    """r^2 at which a ray farther out has its image farther in."""
    return _first_root([1.0, 3.0 * k[0], 5.0 * k[1]], math.inf)


def _equidistant_reach(k: tuple[float, float, float, float]) -> float:
    """The same for the angle of a ray from the axis [rad]."""
    slope = [1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]]
    return math.sqrt(_first_root(slope, math.pi**2))


def _check_fov(fov_deg: float, most_deg: float, within: bool) -> None:
    if not within:
        raise ValueError(
            f"fov_deg must be below {most_deg:.1f} with this distortion, which folds the image "
            f"over beyond, got {fov_deg:g}"
        )


def _check(size_px: tuple[int, int], focal_px: tuple[float, float]) -> None:
    if not min(size_px) > 0:
        raise ValueError(f"size_px must be > 0, got {size_px}")
    if not min(focal_px) > 0.0:
        raise ValueError(f"focal_px must be > 0, got {focal_px}")
