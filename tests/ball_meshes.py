"""One ball as a mesh in many ways."""

import numpy as np
import trimesh

BALL = trimesh.creation.icosphere(subdivisions=2)
V, F = np.asarray(BALL.vertices), np.asarray(BALL.faces)
EAST = V[F].mean(axis=1)[:, 0] > 0


def lines(letter, rows):
    return [" ".join([letter, *map(repr, row)]) for row in rows.tolist()]


def textured_obj():
    """A seam: on one half of the ball the vertices have other texture coordinates."""
    text = lines("v", V) + lines("vt", np.concatenate([V[:, :2], V[:, 1:]]))
    for triangle, east in zip(F, EAST):
        text.append(
            "f " + " ".join(f"{i + 1}/{i + 1 + len(V) * east}" for i in triangle)
        )
    return text, V


def unused_obj():
    """Five unused vertices first, two last, and normals."""
    far = np.array([[9.0, 0, 0]] * 5)
    text = lines("v", far) + lines("v", V) + lines("v", far[:2]) + lines("vn", V)
    faces = [" ".join(f"{i + 6}//{i + 1}" for i in triangle) for triangle in F]
    return [*text, *(f"f {face}" for face in faces)], np.concatenate([far, V, far[:2]])


def materials_obj():
    """Two materials, groups, comments; numbers counted from the end."""
    text = ["# a scan", "mtllib none.mtl", "o ball", *lines("v", V)]
    for name, part in (("skin", F[EAST]), ("hair", F[~EAST])):
        text += [f"usemtl {name}", f"g {name}", "s 1"]
        text += [f"f {a - len(V)} {b - len(V)} {c - len(V)} # x" for a, b, c in part]
    return text, V


def doubled():
    """Every vertex twice, triangles take either copy."""
    copy = np.random.default_rng(0).integers(0, 2, F.shape)
    return np.concatenate([V, V]), F + len(V) * copy
