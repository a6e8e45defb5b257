"""Clouds of points of known surfaces."""

import numpy as np

import manireg as mr
from manireg._discretisation.domain import discretise


def sphere_points(n, radius=1.0):
    return np.asarray(discretise(mr.Sphere(2, radius), n // 16).points)


def sphere_cloud(n, radius=1.0, **options):
    points = sphere_points(n, radius)
    return mr.PointCloud(points, points, **options)


def torus_cloud(n):
    torus = mr.Torus(2.0, 0.8)
    points = np.asarray(discretise(torus, n // 16).points)
    rho = np.linalg.norm(points[:, :2], axis=1, keepdims=True)
    ring = 2.0 * np.append(points[:, :2] / rho, np.zeros((len(points), 1)), axis=1)
    return torus, mr.PointCloud(points, points - ring)
