# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.evaluation import mesh
from skyhaul.evaluation.raster import Camera, Image, draw_lines, draw_triangles
from skyhaul.geometry.shapes import BOX, CAPSULE, SPHERE

CAMERA = Camera(np.array([0.0, -5.0, 0.0]), np.zeros(3), fov_rad=np.pi / 2)
RED, GREEN = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def blank(samples: int = 1) -> Image:
    return Image.blank(101, 101, np.zeros(3), np.zeros(3), samples)


def square(y: float, half: float) -> np.ndarray:
    """A square normal to the view, (2, 3, 3)."""
    c = np.array([[-half, y, -half], [half, y, -half], [half, y, half], [-half, y, half]])
    return c[[[0, 1, 2], [0, 2, 3]]]


def paint(image: Image, corners: np.ndarray, color: np.ndarray, alpha: float = 1.0) -> None:
    n = len(corners)
    draw_triangles(image, CAMERA, corners, np.broadcast_to(color, (n, 3, 3)), np.full(n, alpha))


def test_a_square_covers_the_area_that_perspective_gives() -> None:
    image = blank(samples=4)
    paint(image, square(0.0, 2.0), RED)
    covered = image.rgb[:, :, 0] > 0.5
    assert covered.sum() == pytest.approx((404 * 2.0 / 5.0) ** 2, rel=0.01)
    rows, cols = np.nonzero(covered)
    assert rows.mean() == pytest.approx(201.5)
    assert cols.mean() == pytest.approx(201.5)


def test_right_is_right_and_up_is_up() -> None:
    image = blank()
    paint(image, square(0.0, 0.5) + np.array([2.0, 0.0, 1.0]), RED)
    rows, cols = np.nonzero(image.rgb[:, :, 0] > 0.5)
    assert cols.mean() == pytest.approx(50 + 50.5 * 2.0 / 5.0, abs=0.6)
    assert rows.mean() == pytest.approx(50 - 50.5 * 1.0 / 5.0, abs=0.6)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_surface_wins_in_any_order(order: tuple[int, int]) -> None:
    image = blank()
    squares = ((square(0.0, 1.0), RED), (square(1.0, 2.0), GREEN))
    for k in order:
        paint(image, *squares[k])
    np.testing.assert_array_equal(image.rgb[50, 50], RED)
    np.testing.assert_array_equal(image.rgb[50, 66], GREEN)


def test_what_is_not_opaque_mixes_and_hides_nothing() -> None:
    image = blank()
    paint(image, square(0.0, 1.0), RED, alpha=0.25)
    paint(image, square(1.0, 1.0), GREEN)
    np.testing.assert_array_equal(image.rgb[50, 50], GREEN)
    paint(image, square(0.0, 1.0), RED, alpha=0.25)
    np.testing.assert_allclose(image.rgb[50, 50], 0.25 * RED + 0.75 * GREEN)


def test_two_triangles_of_a_square_leave_no_gap_and_do_not_overlap() -> None:
    image = blank()
    paint(image, square(0.0, 1.7), RED, alpha=0.5)
    seen = np.unique(image.rgb[:, :, 0].round(9))
    np.testing.assert_allclose(seen, [0.0, 0.5])


def test_triangles_behind_the_camera_are_left_out() -> None:
    image = blank()
    paint(image, square(-6.0, 1.0), RED)
    assert image.rgb.max() == 0.0


def test_a_line_is_as_wide_as_told_and_is_cut_at_the_camera() -> None:
    image = blank(samples=4)
    a, b = np.array([[0.0, 0.0, -9.0]]), np.array([[0.0, 0.0, 9.0]])
    draw_lines(image, CAMERA, a, b, RED[None], 5.0)
    assert (image.rgb[200, :, 0] > 0.5).sum() == 20
    through = blank()
    draw_lines(through, CAMERA, np.array([[0.5, -20.0, 0.0]]), np.array([[0.5, 5.0, 0.0]]),
               RED[None], 2.0)  # fmt: skip
    assert through.rgb[:, 70:, 0].max() == 1.0
    assert through.rgb[:, :50, 0].max() == 0.0


@pytest.mark.parametrize(
    ("kind", "size", "volume"),
    [
        (BOX, (0.1, 0.2, 0.3), 8 * 0.1 * 0.2 * 0.3),
        (SPHERE, (0.5, 0.0, 0.0), 4.0 / 3.0 * np.pi * 0.5**3),
        (CAPSULE, (0.2, 0.6, 0.0), 4.0 / 3.0 * np.pi * 0.2**3 + np.pi * 0.2**2 * 1.2),
    ],
)
def test_meshes_are_closed_and_enclose_their_volume(
    kind: int, size: tuple[float, ...], volume: float
) -> None:
    m = mesh.solid(kind, np.array(size))
    a, b, c = m.p[:, 0], m.p[:, 1], m.p[:, 2]
    area = 0.5 * np.cross(b - a, c - a)
    outward = np.sign(np.sum(area * m.n.mean(axis=1), axis=1))
    area *= outward[:, None]
    np.testing.assert_allclose(area.sum(axis=0), 0.0, atol=1e-12)
    enclosed = np.sum(area * (a + b + c) / 3.0) / 3.0
    assert enclosed == pytest.approx(volume, rel=0.03)
    np.testing.assert_allclose(np.linalg.norm(m.n, axis=2), 1.0)


def test_a_placed_mesh_turns_and_moves() -> None:
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    m = mesh.box(np.array([1.0, 2.0, 3.0])).placed(R, np.array([10.0, 0.0, 0.0]))
    np.testing.assert_allclose(m.p.reshape(-1, 3).max(axis=0), [12.0, 1.0, 3.0])
    away = mesh.box(np.ones(3)).placed(np.eye(3), np.array([5.0, 0.0, 0.0]))
    turned = away.placed(R, np.zeros(3))
    np.testing.assert_allclose(turned.p.reshape(-1, 3).mean(axis=0), [0.0, 5.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(turned.n, np.einsum("ij,tkj->tki", R, away.n), atol=1e-12)
