# SPDX-License-Identifier: Apache-2.0
"""IMUs against closed forms, against the plant they ride on, and against their data sheet."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.errors import SkyhaulError
from skyhaul.geometry.kernels import quat_exp, quat_mul
from skyhaul.geometry.quaternion import quat_rotate, quat_to_R
from skyhaul.geometry.so3 import so3_exp
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.sensors.imu import BLOCK, Imu, ImuBank, imu_bank, without_errors
from skyhaul.sensors.imu_kernel import Motion
from skyhaul.types import GRAVITY_MPS2
from skyhaul.world.scenario import AirStart, HoverTask, Scenario

EXACT = without_errors(Imu())
STEP_US, STEP_S = 2_000, 0.002
VEHICLE = 1


def readonly(a):
    a = np.ascontiguousarray(a, dtype=np.float64)
    a.setflags(write=False)
    return a


def motion(q, v, w, n=1):
    """The load and n vehicles that all move alike."""
    one = [readonly(x) for x in (q, v, w)]
    return Motion(*one, *(readonly(np.tile(x, (n, 1))) for x in (q, v, w)))


def run(bank: ImuBank, motions, seed=0):
    """Readings of every IMU of a bank, stacked: stamps (m,), gyro and accel (m, 3)."""
    memory, rows = bank.init(seed), [[] for _ in bank.imus]
    for k, m in enumerate(motions):
        memory, readings = bank.step(memory, k * STEP_US, m)
        for row, reading in zip(rows, readings, strict=True):
            row.append(reading)
    return [
        (
            np.concatenate([r.stamp_us for r in row]),
            np.concatenate([r.gyro_I for r in row]),
            np.concatenate([r.accel_I for r in row]),
        )
        for row in rows
    ]


def level(v=(0.0, 0.0, 0.0), w=(0.0, 0.0, 0.0)):
    return motion((1.0, 0.0, 0.0, 0.0), v, w)


def test_at_rest_it_reads_g_upwards_and_no_rate() -> None:
    ((_, gyro, accel),) = run(imu_bank([EXACT], [VEHICLE]), [level()] * 5)
    assert len(gyro) == 4
    np.testing.assert_allclose(accel, [[0.0, 0.0, GRAVITY_MPS2]] * 4, atol=1e-12)
    np.testing.assert_allclose(gyro, 0.0, atol=1e-12)


def test_in_free_fall_it_reads_nothing() -> None:
    falls = [level(v=(0.3, 0.0, -GRAVITY_MPS2 * STEP_S * k)) for k in range(6)]
    ((_, _, accel),) = run(imu_bank([EXACT], [VEHICLE]), falls)
    np.testing.assert_allclose(accel, 0.0, atol=1e-11)


def test_a_turned_imu_reads_gravity_in_its_own_axes() -> None:
    turned = replace(EXACT, rotation_deg=(0.0, 90.0, 0.0))  # its x axis points down
    ((_, _, accel),) = run(imu_bank([turned], [VEHICLE]), [level()] * 2)
    np.testing.assert_allclose(accel, [[-GRAVITY_MPS2, 0.0, 0.0]], atol=1e-12)


def test_off_the_axis_of_a_steady_turn_it_reads_the_centripetal_acceleration() -> None:
    rate, arm = 7.0, np.array([0.05, 0.02, 0.03])
    imu = replace(EXACT, p_BI_m=tuple(arm))
    w = np.array([0.0, 0.0, rate])
    turning = [motion(quat_exp(w * STEP_S * k), np.zeros(3), w) for k in range(10)]
    ((_, gyro, accel),) = run(imu_bank([imu], [VEHICLE]), turning)
    expected = np.array([-(rate**2) * arm[0], -(rate**2) * arm[1], GRAVITY_MPS2])
    mean = np.sinc(rate * STEP_S / 2.0 / np.pi)  # of a vector that turns during the step
    np.testing.assert_allclose(gyro, np.tile(w, (9, 1)), atol=1e-11)
    np.testing.assert_allclose(accel, np.tile(expected * [mean, mean, 1.0], (9, 1)), atol=1e-9)


def test_the_arm_feels_angular_acceleration() -> None:
    alpha, arm = 20.0, 0.1
    imu = replace(EXACT, p_BI_m=(arm, 0.0, 0.0))
    spins = [
        motion(quat_exp(np.array([0, 0, 0.5 * alpha * t * t])), np.zeros(3), [0, 0, alpha * t])
        for t in STEP_S * np.arange(3)
    ]
    ((_, _, accel),) = run(imu_bank([imu], [VEHICLE]), spins)
    np.testing.assert_allclose(accel[0, 1], alpha * arm, rtol=1e-3)


def test_samples_are_stamped_in_the_middle_of_what_they_average() -> None:
    slow = replace(EXACT, rate_hz=100, clock_offset_us=37)
    speeds = np.cumsum(np.arange(11.0)) * STEP_S  # acceleration k during step k
    moves = [level(v=(s, 0.0, 0.0)) for s in speeds]
    fast, late = run(imu_bank([EXACT, slow], [VEHICLE, VEHICLE]), moves)
    assert fast[0].tolist() == [1000 + STEP_US * k for k in range(10)]
    assert late[0].tolist() == [5037, 15037]
    np.testing.assert_allclose(fast[2][:, 0], np.arange(1.0, 11.0), atol=1e-9)
    np.testing.assert_allclose(late[2][:, 0], [3.0, 8.0], atol=1e-9)


def flight(seconds: float):
    """States of a plant whose rotors are jerked about, from hover."""
    scenario = Scenario(start=AirStart(payload_m=(5.0, 5.0, 5.0)), task=HoverTask())
    plant, rng = MujocoPlant(scenario, 0), np.random.default_rng(3)
    truths, hover = [plant.truth()], plant.truth().rotor_thrust
    for k in range(round(seconds / STEP_S)):
        if k % 25 == 0:
            command = hover + rng.uniform(-0.12, 0.12, hover.shape)
        truths.append(plant.step(command))
    return truths


def of(truth) -> Motion:
    t = truth.team
    return Motion(t.q_WL, t.v_WL, t.w_WL_L, t.q_WB, t.v_WB, t.w_WB_B)


def integrate(q, p, v, gyro, accel, step_s):
    """Strapdown integration of readings held over their steps."""
    for w, f in zip(gyro, accel, strict=True):
        middle = np.array(quat_mul(tuple(q), quat_exp(0.5 * step_s * w)))
        a = quat_rotate(middle, f) - np.array([0.0, 0.0, GRAVITY_MPS2])
        p, v = p + step_s * v + 0.5 * step_s**2 * a, v + step_s * a
        q = np.array(quat_mul(tuple(q), quat_exp(step_s * w)))
    return q, p, v


@pytest.mark.parametrize(("rate_hz", "gap_m"), [(500, 2e-4), (100, 5e-3)])
def test_exact_readings_lead_back_to_the_true_motion(rate_hz, gap_m) -> None:
    arm = np.array(EXACT.p_BI_m)
    truths = flight(2.0)
    assert any(t.contacts for t in truths), "the team tumbles and crashes on the way"
    wide = replace(EXACT, rate_hz=rate_hz, gyro_range_radps=100.0, accel_range_mps2=1e4)
    bank = imu_bank([wide] * 5, range(5))
    readings = run(bank, [of(t) for t in truths])
    first, last = truths[0].team, truths[-1].team
    for b in range(5):
        q0, p0, v0, w0 = (
            (first.q_WL, first.p_WL, first.v_WL, first.w_WL_L)
            if b == 0
            else (first.q_WB[b - 1], first.p_WB[b - 1], first.v_WB[b - 1], first.w_WB_B[b - 1])
        )
        q1, p1, v1, w1 = (
            (last.q_WL, last.p_WL, last.v_WL, last.w_WL_L)
            if b == 0
            else (last.q_WB[b - 1], last.p_WB[b - 1], last.v_WB[b - 1], last.w_WB_B[b - 1])
        )
        start = p0 + quat_rotate(q0, arm), v0 + quat_rotate(q0, np.cross(w0, arm))
        q, p, v = integrate(q0, *start, readings[b][1], readings[b][2], 1.0 / rate_hz)
        assert np.linalg.norm(p1 - p0) > 0.5
        assert np.linalg.norm(p - (p1 + quat_rotate(q1, arm))) < gap_m
        v1_I = v1 + quat_rotate(q1, np.cross(w1, arm))
        np.testing.assert_allclose(v, v1_I, atol=1e-8)
        assert abs(abs(q @ q1) - 1.0) < 1e-12


def test_the_reading_is_linear_in_the_truth_with_the_units_matrix_and_bias() -> None:
    imu = replace(
        EXACT,
        gyro_bias_radps=0.1,
        accel_bias_mps2=0.2,
        accel_scale_error=0.05,
        misalignment_deg=2.0,
    )
    bank = imu_bank([imu], [VEHICLE])
    memory = bank.init(5)
    w = np.array([0.3, -0.2, 0.5])
    spin = [motion(quat_exp(w * STEP_S * k), np.zeros(3), w) for k in range(2)]
    ((_, gyro, _),) = run(bank, spin, seed=5)
    np.testing.assert_allclose(gyro[0], memory.errors.gyro[0] @ w + memory.bias[0, :3], atol=1e-9)
    ((_, _, accel),) = run(bank, [level()] * 2, seed=5)
    g = np.array([0.0, 0.0, GRAVITY_MPS2])
    np.testing.assert_allclose(accel[0], memory.errors.accel[0] @ g + memory.bias[0, 3:])
    assert np.abs(memory.errors.accel[0] - np.eye(3)).max() > 0.01


def test_units_differ_as_the_data_sheet_says() -> None:
    imu = Imu(gyro_bias_radps=0.01, accel_scale_error=0.03, misalignment_deg=1.0)
    memories = [imu_bank([imu], [VEHICLE]).init(seed) for seed in range(400)]
    bias = np.array([m.bias[0] for m in memories])
    accel = np.array([m.errors.accel[0] for m in memories]) - np.eye(3)
    assert bias[:, :3].std() == pytest.approx(0.01, rel=0.1)
    assert accel[:, [0, 1, 2], [0, 1, 2]].std() == pytest.approx(0.03, rel=0.1)
    off = accel[:, [0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]]
    assert off.std() == pytest.approx(np.deg2rad(1.0), rel=0.1)


def test_beyond_its_range_it_saturates() -> None:
    imu = replace(EXACT, gyro_range_radps=2.0, accel_range_mps2=5.0)
    w = np.array([3.0, -4.0, 1.0])
    spin = [motion(quat_exp(w * STEP_S * k), np.zeros(3), w) for k in range(2)]
    ((_, gyro, accel),) = run(imu_bank([imu], [VEHICLE]), spin)
    np.testing.assert_allclose(gyro[0], [2.0, -2.0, 1.0], atol=1e-9)
    assert accel[0, 2] == 5.0


def test_readings_are_whole_digits() -> None:
    imu = replace(Imu(), gyro_lsb_radps=0.01, accel_lsb_mps2=0.05)
    ((_, gyro, accel),) = run(imu_bank([imu], [VEHICLE]), [level()] * 50)
    for values, lsb in ((gyro, 0.01), (accel, 0.05)):
        digits = values / lsb
        np.testing.assert_allclose(digits, np.round(digits), atol=1e-6)
        assert len(np.unique(np.round(digits))) > 1


def test_noise_and_walk_have_the_density_they_are_given() -> None:
    imu = replace(EXACT, gyro_noise_radps_per_sqrt_hz=1e-3, accel_walk_mps3_per_sqrt_hz=0.1)
    ((_, gyro, accel),) = run(imu_bank([imu], [VEHICLE]), [level()] * 10_001)
    assert gyro.std() == pytest.approx(1e-3 * np.sqrt(500.0), rel=0.02)
    steps = np.diff(accel, axis=0)
    # the mean of a Wiener process over neighbouring periods: variance of a step 2/3 K^2 T,
    # covariance of neighbouring steps K^2 T / 6
    scale = 0.1**2 / 500.0
    assert np.mean(steps**2) == pytest.approx(2.0 / 3.0 * scale, rel=0.03)
    assert np.mean(steps[1:] * steps[:-1]) == pytest.approx(scale / 6.0, rel=0.15)


def test_noise_and_walk_are_drawn_apart() -> None:
    imu = replace(EXACT, gyro_noise_radps_per_sqrt_hz=1e-3, gyro_walk_radps2_per_sqrt_hz=0.5)
    bank = imu_bank([imu], [VEHICLE])
    memory, gap = bank.init(2), []
    for k in range(4_000):
        memory, (reading,) = bank.step(memory, k * STEP_US, level())
        gap += (reading.gyro_I - memory.bias[:, :3]).tolist()
    # the mean over a period less the bias at its end: K^2 T / 3 of the walk, N^2 / T of the noise
    assert np.std(gap) == pytest.approx(np.sqrt(0.5**2 / 500.0 / 3.0 + 1e-6 * 500.0), rel=0.03)


def test_each_imu_of_a_bank_reads_as_if_it_were_alone() -> None:
    kinds, bodies = [Imu(), Imu(rate_hz=100), Imu(p_BI_m=(0.0, 0.1, 0.0))], [0, 2, 1]
    q = np.array([so3_exp(np.array([0.01 * k, 0.02, 0.0])) for k in range(BLOCK + 30)])
    moves = [motion(quat_exp(np.array([0.01 * k, 0.02, 0.0])), (0.1 * k, 0, 0), (5, 0, 0), n=2)
             for k in range(len(q))]  # fmt: skip
    together = run(imu_bank(kinds, bodies), moves, seed=11)
    for r in (2, 0, 1):
        (alone,) = run(imu_bank([kinds[r]], [bodies[r]]), moves, seed=11)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(together[r], alone, strict=True))


def test_stepping_twice_from_one_memory_gives_the_same() -> None:
    bank = imu_bank([Imu()], [VEHICLE])
    memory, _ = bank.step(bank.init(1), 0, level())
    once, twice = bank.step(memory, STEP_US, level()), bank.step(memory, STEP_US, level())
    assert once[1][0].accel_I.tobytes() == twice[1][0].accel_I.tobytes()
    assert once[0].state.tobytes() == twice[0].state.tobytes()


def test_seeds_and_bodies_have_streams_of_their_own() -> None:
    def noise(seed, body):
        return run(imu_bank([Imu()], [body]), [level()] * 3, seed)[0][1]

    assert noise(0, 1).tobytes() == noise(0, 1).tobytes()
    assert len({noise(s, b).tobytes() for s in (0, 1) for b in (0, 1)}) == 4


def test_a_skipped_step_of_the_plant_is_refused() -> None:
    bank = imu_bank([EXACT], [VEHICLE])
    memory, _ = bank.step(bank.init(0), 0, level())
    with pytest.raises(SkyhaulError, match="after 0 us comes 2000 us, got 4000 us"):
        bank.step(memory, 2 * STEP_US, level())


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        ({"rate_hz": 300}, "rate_hz must divide 500, got 300"),
        ({"rate_hz": 0}, "rate_hz must divide 500, got 0"),
        ({"gyro_noise_radps_per_sqrt_hz": -1.0}, "must be >= 0"),
        ({"accel_range_mps2": 0.0}, "accel_range_mps2 must be > 0, got 0.0"),
        ({"gyro_scale_error": 0.5}, "below 0.2"),
    ],
)
def test_impossible_parameters_are_refused(entry, sentence) -> None:
    with pytest.raises(ValueError, match=sentence):
        Imu(**entry)


def test_the_calibration_tells_what_the_file_says() -> None:
    known = Imu(rotation_deg=(0.0, 0.0, 90.0), clock_offset_us=5).calibration()
    np.testing.assert_allclose(known.R_BI @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(quat_to_R(np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])), known.R_BI,
                               atol=1e-12)  # fmt: skip
    assert (known.rate_hz, known.clock_offset_us, known.gyro_noise) == (500, 5, 2.44e-4)
