"""Similarities from shapes alone, beside those that made the target."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import manireg as mr

BALL = trimesh.creation.icosphere(subdivisions=4)


def shape(p):
    """Without a symmetry."""
    r = 1 + 0.2 * np.sin(4 * p[:, :1] + 1) * np.cos(4 * p[:, 1:2])
    return p * (r + 0.15 * np.cos(5 * p[:, 2:] + p[:, :1])) * [1.0, 1.3, 0.8]


SOURCE = trimesh.Trimesh(shape(BALL.vertices), BALL.faces, process=False)


def elsewhere(seed):
    """The same shape at other vertices, turned, scaled and moved; and by what."""
    turn = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0])
    q = trimesh.transform_points(BALL.vertices, turn)
    turned = Rotation.from_quat(np.random.default_rng(seed).normal(size=4))
    matrix = np.eye(4)
    matrix[:3, :3] = 40 * turned.as_matrix()
    matrix[:3, 3] = [3e3, -5.0, 70.0]
    moved = trimesh.transform_points(shape(q), matrix)
    return trimesh.Trimesh(moved, BALL.faces, process=False), matrix


@pytest.mark.parametrize("seed", range(2))
def test_the_similarity_is_found(seed):
    target, matrix = elsewhere(seed)
    found = mr.align(SOURCE, target)
    gaps = np.linalg.norm(
        trimesh.transform_points(SOURCE.vertices, found)
        - trimesh.transform_points(SOURCE.vertices, matrix),
        axis=1,
    )
    assert gaps.max() < 0.02 * 40
    assert np.linalg.det(found[:3, :3]) ** (1 / 3) == pytest.approx(40, rel=0.01)
    np.testing.assert_array_equal(mr.align(SOURCE, target), found)


def test_what_looks_alike_from_two_sides_is_said():
    turn = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0])
    elsewhere = trimesh.transform_points(BALL.vertices, turn)
    eggs = [
        trimesh.Trimesh(p * [1.0, 1.3, 0.8], BALL.faces, process=False)
        for p in (np.asarray(BALL.vertices), elsewhere)
    ]
    with pytest.warns(UserWarning, match="another rotation fits about as well"):
        mr.align(*eggs)


@pytest.mark.slow
def test_register_without_landmarks():
    target, matrix = elsewhere(5)
    truth = trimesh.transform_points(SOURCE.vertices, matrix)
    start = mr.align(SOURCE, target)
    found = mr.register(SOURCE, target, start=start, surface=True, progress=False)
    errors = np.linalg.norm(found.vertices - truth, axis=1)
    assert errors.mean() < 0.03 * 40
    assert found.landmark_errors.shape == (0,) and found.landmark_names == ()
    certificate = found.report()
    agreement = certificate.agreement
    assert certificate.left_out is None and agreement is not None
    assert not np.any(agreement < 0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "mr.align"),
        ({"start": np.eye(4)}, "surface=True"),
        ({"start": np.eye(3), "surface": True}, r"finite matrix \(4, 4\)"),
        ({"start": np.diag([-1.0, 1, 1, 1]), "surface": True}, "reflection"),
        ({"start": np.eye(4), "source_landmarks": np.arange(5)}, "not with landmarks"),
        ({"source_landmarks": np.arange(5)}, "give `source_landmarks` and"),
    ],
)
def test_bad_starts(options, message):
    with pytest.raises(ValueError, match=message):
        mr.register(SOURCE, SOURCE, **options)
