"""Quaternions do what scipy's rotations do, and the cases that have no answer have a defined one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ha2g_jax.motion import rotations


def some(count: int = 200, seed: int = 0) -> np.ndarray:
    return rotations.unit(np.random.default_rng(seed).normal(size=(count, 4)))


def same(a: np.ndarray, b: np.ndarray, atol: float = 1e-7) -> None:
    np.testing.assert_allclose(rotations.angle_between(a, b), 0, atol=atol)


def test_products_and_turned_vectors_agree_with_scipy():
    a, b = some(seed=1), some(seed=2)
    v = np.random.default_rng(3).normal(size=(200, 3))
    same(rotations.multiply(a, b), (Rotation.from_quat(a) * Rotation.from_quat(b)).as_quat())
    np.testing.assert_allclose(rotations.rotate(a, v), Rotation.from_quat(a).apply(v), atol=1e-12)
    same(rotations.multiply(a, rotations.conjugate(a)), np.broadcast_to(rotations.IDENTITY, a.shape))
    assert rotations.multiply(a[:, None], b[None, :3]).shape == (200, 3, 4)


def test_every_form_of_a_rotation_comes_back():
    q = some()
    same(rotations.from_matrix(rotations.to_matrix(q)), q)
    same(rotations.from_vector(rotations.to_vector(q)), q)
    for order in ("ZXY", "ZYX", "XYZ"):
        same(rotations.from_euler(rotations.to_euler(q, order), order), q)
    matrices = rotations.to_matrix(q)
    np.testing.assert_allclose(matrices, Rotation.from_quat(q).as_matrix(), atol=1e-12)
    assert rotations.to_euler(q.reshape(2, 100, 4)).shape == (2, 100, 3)


def test_euler_angles_are_intrinsic_and_the_pole_gives_no_warning():
    turned = rotations.to_euler(rotations.about(np.array([1.0, 0, 0]), np.deg2rad(30)), "ZXY")
    np.testing.assert_allclose(turned, [0, 30, 0], atol=1e-12)
    pole = rotations.from_euler(np.array([[20.0, 90.0, 0.0]]))
    same(rotations.from_euler(rotations.to_euler(pole)), pole, atol=1e-6)


def test_small_and_half_turns_have_exact_vectors():
    angles = np.array([0.0, 1e-9, 1e-4, np.pi])
    axis = rotations.unit(np.array([1.0, 2.0, -2.0]))
    vectors = rotations.to_vector(rotations.about(axis, angles))
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1), angles, rtol=1e-9, atol=1e-15)


def test_the_shortest_swing_takes_one_vector_to_the_other():
    random = np.random.default_rng(4)
    u, v = rotations.unit(random.normal(size=(2, 300, 3)))
    swing = rotations.between(3 * u, v)
    np.testing.assert_allclose(rotations.rotate(swing, u), v, atol=1e-12)
    angle = np.arccos(np.sum(u * v, axis=-1))
    np.testing.assert_allclose(np.linalg.norm(rotations.to_vector(swing), axis=-1), angle, atol=1e-7)


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-8, 1e-6, 1e-3])
def test_opposite_vectors_are_half_a_turn_apart(tilt):
    u = np.concatenate([np.eye(3), rotations.unit(np.random.default_rng(5).normal(size=(50, 3)))])
    v = rotations.unit(-u + tilt * rotations.perpendicular(u))
    turned = rotations.rotate(rotations.between(u, v), u)
    np.testing.assert_allclose(turned, v, atol=1e-6)


def test_signs_do_not_jump():
    angles = np.linspace(0, 6 * np.pi, 90)
    q = rotations.about(np.array([0.0, 1.0, 0.0]), angles)
    canonical = np.where(q[:, 3:] < 0, -q, q)
    assert (np.sum(canonical[1:] * canonical[:-1], axis=-1) < 0).any()  # there is something to repair
    repaired = rotations.continuous(canonical)
    assert (np.sum(repaired[1:] * repaired[:-1], axis=-1) > 0).all()
    same(repaired, q)
    assert rotations.continuous(-q[:1])[0, 3] > 0


def test_a_rotation_is_its_twist_and_then_its_swing():
    q, axis = some(), rotations.unit(np.array([1.0, -1.0, 0.5]))
    swing, twist = rotations.split_twist(q, axis)
    same(rotations.multiply(swing, twist), q)
    np.testing.assert_allclose(rotations.rotate(twist, axis), np.broadcast_to(axis, (200, 3)), atol=1e-9)
    np.testing.assert_allclose(rotations.to_vector(swing) @ axis, 0, atol=1e-9)
    angle = np.linspace(-3, 3, 50)
    np.testing.assert_allclose(rotations.twist_angle(rotations.about(axis, angle), axis), angle, atol=1e-9)


def test_a_bone_that_is_turned_round_has_a_defined_twist():
    flipped = rotations.about(np.array([0.0, 1.0, 0.0]), np.pi)
    swing, twist = rotations.split_twist(flipped, np.array([1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(twist, rotations.IDENTITY)
    same(swing, flipped)


def test_slerp_goes_the_short_way_at_a_steady_pace():
    a = some(1)[0]
    b = -rotations.multiply(rotations.about(np.array([0.0, 0.0, 1.0]), 1.0), a)
    fractions = np.linspace(0, 1, 11)
    between = rotations.slerp(a, b, fractions)
    same(between[0], a)
    same(between[-1], b)
    np.testing.assert_allclose(rotations.angle_between(between[1:], between[:-1]), 0.1, atol=1e-9)


def test_the_fit_is_that_of_scipy_and_reports_its_certainty():
    random = np.random.default_rng(0)
    rest = rotations.unit(random.normal(size=(4, 3)))
    q = rotations.unit(random.normal(size=(30, 4)))
    seen = rotations.unit(rotations.rotate(q[:, None], rest) + random.normal(0, 0.05, (30, 4, 3)))
    fitted, certainty = rotations.fit(seen, rest)
    expected = [Rotation.align_vectors(vectors, rest)[0].as_quat() for vectors in seen]
    same(fitted, np.array(expected), atol=1e-6)
    assert certainty.min() > 0.8
    fitted, certainty = rotations.fit(np.broadcast_to(np.eye(3)[0], (30, 4, 3)), rest)
    np.testing.assert_allclose(certainty, 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(fitted, axis=-1), 1, atol=1e-9)
