# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.errors import FileError, GeometryError
from skyhaul.evaluation.trajectory_error import (
    Matched,
    Trajectory,
    align,
    match,
    pose_nees,
    position_nees,
    trajectory_error,
)
from skyhaul.evaluation.trajectory_file import check_out, read_trajectory, write_tum
from skyhaul.geometry.quaternion import R_to_quat, quat_to_R
from skyhaul.geometry.so3 import rotation_z, so3_exp


def path(n=101, seed=0):
    """A random walk of poses, 50 ms apart."""
    rng = np.random.default_rng(seed)
    R = [np.eye(3)]
    for w in 0.1 * rng.normal(size=(n - 1, 3)):
        R.append(R[-1] @ so3_exp(w))
    p = np.cumsum(0.1 * rng.normal(size=(n, 3)), axis=0)
    return Trajectory(50_000_000 * np.arange(n) + 10**18, p, R_to_quat(np.array(R)))


def moved(t, R, shift, scale=1.0):
    return Trajectory(t.time_ns.copy(), scale * t.p @ R.T + shift, R_to_quat(R @ quat_to_R(t.q)))


def pairs(estimate, truth):
    return Matched(estimate, truth, np.arange(len(truth.time_ns)))


TURN = so3_exp(np.array([0.4, -1.0, 2.0]))


def test_alignment_undoes_any_motion_and_scale():
    p = path().p
    s, R, t = align(p, 2.5 * p @ TURN.T + [1, 2, 3], with_scale=True)
    assert s == pytest.approx(2.5)
    np.testing.assert_allclose(R, TURN, atol=1e-12)
    np.testing.assert_allclose(t, [1, 2, 3], atol=1e-12)


def test_alignment_never_mirrors():
    p = path().p
    _, R, _ = align(p, p * [1.0, 1.0, -1.0], with_scale=False)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_alignment_is_the_best_of_many():
    rng = np.random.default_rng(1)
    p, q = path().p, path(seed=2).p
    s, R, t = align(p, q, with_scale=True)
    best = np.sum((s * p @ R.T + t - q) ** 2)
    for _ in range(200):
        R2, s2 = R @ so3_exp(0.05 * rng.normal(size=3)), s * (1.0 + 0.05 * rng.normal())
        assert best <= np.sum((s2 * p @ R2.T + t + 0.02 * rng.normal(size=3) - q) ** 2)


@pytest.mark.parametrize(("alignment", "scale"), [("se3", 1.0), ("sim3", 1.3)])
def test_a_moved_trajectory_has_no_error(alignment, scale):
    truth = path()
    error = trajectory_error(pairs(moved(truth, TURN, [5, 6, 7], scale), truth), alignment)
    assert error.ate_m < 1e-12
    assert error.rpe_m < 1e-12
    assert error.rpe_deg < 1e-6
    assert error.scale == pytest.approx(1.0 / scale)
    assert error.matched == 101


def test_without_alignment_a_shift_is_the_error():
    truth = path()
    error = trajectory_error(pairs(moved(truth, np.eye(3), [0.3, 0.0, 0.4]), truth), "none")
    assert error.ate_m == pytest.approx(0.5)
    assert error.ate_max_m == pytest.approx(0.5)
    assert error.rpe_m < 1e-12


def test_noise_comes_out_as_it_went_in():
    truth, rng = path(2001), np.random.default_rng(3)
    noisy = Trajectory(
        truth.time_ns.copy(), truth.p + 0.02 * rng.normal(size=(2001, 3)), truth.q.copy()
    )
    error = trajectory_error(pairs(noisy, truth))
    assert error.ate_m == pytest.approx(0.02 * np.sqrt(3.0), rel=0.03)
    assert error.rpe_m == pytest.approx(0.02 * np.sqrt(6.0), rel=0.03)


def test_a_constant_drift_is_the_relative_error():
    # 1 cm and 0.1 deg more in each frame's own axes: 20 frames make a second.
    n = 200
    turn = so3_exp(np.radians([0.0, 0.0, 0.1]))
    R = [np.linalg.matrix_power(turn, k) for k in range(n)]
    times, zero = 50_000_000 * np.arange(n), np.zeros((n, 3))
    truth = Trajectory(times, zero, np.tile([1.0, 0, 0, 0], (n, 1)))
    error = trajectory_error(pairs(Trajectory(times, zero, R_to_quat(np.array(R))), truth))
    assert error.rpe_deg == pytest.approx(2.0)
    straight = Trajectory(times, np.outer(np.arange(n), [0.01, 0, 0]), truth.q)
    assert trajectory_error(pairs(straight, truth)).rpe_m == pytest.approx(0.2)


def test_truth_is_interpolated_between_its_neighbours():
    q = np.array([[1.0, 0, 0, 0], R_to_quat(rotation_z(0.4))])
    truth = Trajectory(np.array([0, 80_000_000]), np.array([[0.0, 0, 0], [1, 2, 3]]), q)
    times = np.array([-1, 0, 20_000_000, 80_000_000, 80_000_001])
    ours = Trajectory(times, np.zeros((5, 3)), np.tile([1.0, 0, 0, 0], (5, 1)))
    found = match(ours, truth)
    np.testing.assert_array_equal(found.row, [1, 2, 3])
    np.testing.assert_allclose(found.truth.p, [[0, 0, 0], [0.25, 0.5, 0.75], [1, 2, 3]])
    np.testing.assert_allclose(quat_to_R(found.truth.q[1]), rotation_z(0.1), atol=1e-12)


def test_no_truth_is_made_up_in_a_gap():
    truth = Trajectory(
        np.array([0, 300_000_000]), np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1))
    )
    ours = Trajectory(np.array([100_000_000]), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))
    assert len(match(ours, truth).row) == 0


def test_nees_of_errors_drawn_from_the_covariance_is_six():
    rng, n = np.random.default_rng(4), 4000
    sigma = np.array([0.02, 0.03, 0.01, 0.01, 0.02, 0.015])
    e = sigma * rng.normal(size=(n, 6))
    e[0] = 0.0
    q = np.tile([1.0, 0, 0, 0], (n, 1))
    ours = Trajectory(np.arange(n), np.zeros((n, 3)), q)
    R = rotation_z(0.7) @ so3_exp(e[:, 3:])  # the truth stands in other axes
    truth = Trajectory(np.arange(n), e[:, :3] @ rotation_z(0.7).T + [1, 2, 3], R_to_quat(R))
    nees = pose_nees(pairs(ours, truth), np.tile(np.diag(sigma**2), (n, 1, 1)))
    assert np.mean(nees) == pytest.approx(6.0, abs=0.2)
    assert np.mean(nees < 12.59) == pytest.approx(0.95, abs=0.01)
    place = position_nees(pairs(ours, truth), np.tile(np.diag(sigma**2), (n, 1, 1)))
    assert np.mean(place) == pytest.approx(3.0, abs=0.15)


def test_shapes_and_times_are_checked():
    with pytest.raises(GeometryError, match=r"p \(n, 3\)"):
        Trajectory(np.arange(3), np.zeros((2, 3)), np.zeros((3, 4)))
    with pytest.raises(GeometryError, match="must grow"):
        Trajectory(np.array([1, 1]), np.zeros((2, 3)), np.zeros((2, 4)))


def test_tum_text_comes_back_to_the_nanosecond(tmp_path):
    t = path(20)
    write_tum(tmp_path / "t.txt", t)
    back = read_trajectory(tmp_path / "t.txt")
    np.testing.assert_array_equal(back.time_ns, t.time_ns)
    np.testing.assert_allclose(back.p, t.p, atol=1e-9)
    np.testing.assert_allclose(quat_to_R(back.q), quat_to_R(t.q), atol=1e-8)


def test_euroc_truth_has_w_first_and_integer_times(tmp_path):
    file = tmp_path / "data.csv"
    file.write_text("#timestamp, ...\n1403715273262142976,1,2,3,0.6,0.8,0,0,9,9,9\n")
    t = read_trajectory(file)
    assert t.time_ns[0] == 1403715273262142976
    np.testing.assert_allclose(t.q, [[0.6, 0.8, 0.0, 0.0]])
    np.testing.assert_allclose(t.p, [[1, 2, 3]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "holds no pose"),
        (b"# only a header\n", "holds no pose"),
        (b"\xff\xfe\x00\x01", "is no text file"),
        (b"1 2 3\n", "line 1 is no pose: it has 3 numbers"),
        (b"a,b,c\n", "line 1 is no pose"),
        (b"1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 5\n", "line 2 .* the length 5, no unit quaternion"),
        (b"2 0 0 0 0 0 0 1\n\n1 0 0 0 0 0 0 1\n", "line 3: its time .* line 1 .* must grow"),
        (b"1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "line 2: its time .* must grow"),
        (b"1 0 nan 0 0 0 0 1\n", "line 1 is no pose: 'nan' is not finite"),
        (b"1 0 1e160 0 0 0 0 1\n", "line 1 is no pose: '1e160' is not finite or beyond 1e"),
        (b"1 0 0 0 0 0 1e160 1\n", "line 1 is no pose: '1e160' is not finite or beyond 1e"),
        (b"inf 0 0 0 0 0 0 1\n", "'inf' is not finite"),
        (b"1e400 0 0 0 0 0 0 1\n", "'1e400' is not finite"),
        (b"1403715273262142976 0 0 0 0 0 0 1\n", "is no time in seconds, rather nanoseconds"),
        (b"1403715273.26,0,0,0,1,0,0,0\n", "is no time in whole nanoseconds"),
        (b"99999999999999999999,0,0,0,1,0,0,0\n", "is no time in whole nanoseconds"),
        (b"1 0 0 0 0 0 0 1 9\n", "line 1 is no pose: it has 9 numbers"),
    ],
)
def test_what_is_no_trajectory_is_refused_in_one_sentence(tmp_path, content, message):
    file = tmp_path / "x.txt"
    file.write_bytes(content)
    with pytest.raises(FileError, match=message) as caught:
        read_trajectory(file)
    assert "\n" not in str(caught.value)


def test_a_missing_trajectory_is_refused(tmp_path):
    with pytest.raises(FileError, match="cannot be read: No such file"):
        read_trajectory(tmp_path / "none.txt")


def test_no_motion_is_made_up_over_a_gap_either():
    truth = path(61)
    kept = np.r_[0:15, 45:61]  # 0.7 s, a gap of 1.55 s, 0.75 s
    error = trajectory_error(pairs(truth.rows(kept), truth.rows(kept)))
    assert error.rpe_pairs == 0
    assert np.isnan(error.rpe_m)
    assert trajectory_error(pairs(truth, truth)).rpe_pairs == 41


def test_a_truth_of_one_pose_has_one_pair_at_its_time():
    truth = path()
    found = match(truth, truth.rows(np.array([7])))
    np.testing.assert_array_equal(found.row, [7])
    np.testing.assert_allclose(found.truth.p, truth.p[[7]])


def test_a_trajectory_is_written_whole_or_not_at_all(tmp_path):
    write_tum(tmp_path / "a.txt", path(5))
    assert [f.name for f in tmp_path.iterdir()] == ["a.txt"]
    (tmp_path / "folder").mkdir()
    with pytest.raises(FileError, match="cannot be written: Is a directory"):
        write_tum(tmp_path / "folder", path(5))
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a.txt", "folder"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("there.txt", "is there already"),
        ("folder", "is a folder"),
        ("none/x.txt", "cannot be written: No such file"),
        ("there.txt/x.txt", "cannot be written: Not a directory"),
        ("half.txt", "half.txt.part: cannot be written: File exists"),
        ("x" * 300, "cannot be written: File name too long"),
    ],
)
def test_a_place_that_takes_no_file_is_refused_before_there_is_one(tmp_path, name, message):
    (tmp_path / "there.txt").write_text("mine")
    (tmp_path / "half.txt.part").write_text("mine too")
    (tmp_path / "folder").mkdir()
    with pytest.raises(FileError, match=message):
        check_out(tmp_path / name)
    assert (tmp_path / "there.txt").read_text() == "mine"
    check_out(tmp_path / "new.txt")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["folder", "half.txt.part", "there.txt"]
