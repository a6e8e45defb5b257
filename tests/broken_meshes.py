"""One surface as a mesh with one fault, and with two: what scanners, programs and formats
make of it. No two distances in it are equal, so that nothing hangs on rounding."""

import itertools
from typing import NamedTuple

import numpy as np
import trimesh
from ball_meshes import F, V, lines

RNG = np.random.default_rng(5)
W = V * [1.0, 1.2, 0.8] + 0.15 * np.sin(2 * V[:, [1, 2, 0]])
W = W + 0.01 * RNG.normal(size=V.shape)
N = len(W)


class Broken(NamedTuple):
    vertices: np.ndarray
    faces: np.ndarray
    numbers: np.ndarray
    """Of the vertices of the sound mesh."""
    scale: float = 1.0
    shift: np.ndarray = np.zeros(3)


SOUND = Broken(W, F, np.arange(N))


def unused(mesh: Broken) -> Broken:
    far = np.array([[40.0, 0, 0]] * 5)
    vertices = np.concatenate([far, mesh.vertices, far[:2]])
    return mesh._replace(
        vertices=vertices, faces=mesh.faces + 5, numbers=mesh.numbers + 5
    )


def unused_nan(mesh: Broken) -> Broken:
    vertices = np.concatenate([np.full((1, 3), np.nan), mesh.vertices])
    return mesh._replace(
        vertices=vertices, faces=mesh.faces + 1, numbers=mesh.numbers + 1
    )


def with_nan_triangles(mesh: Broken) -> Broken:
    """Triangles to a vertex without a place, beside the surface."""
    n = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, np.full((1, 3), np.inf)])
    return mesh._replace(
        vertices=vertices, faces=np.concatenate([mesh.faces, [[0, 1, n], [5, n, 2]]])
    )


def soup(mesh: Broken) -> Broken:
    """Each triangle with corners of its own, behind the vertices it had."""
    n, corners = len(mesh.vertices), mesh.faces.size
    vertices = np.concatenate([mesh.vertices, mesh.vertices[mesh.faces.ravel()]])
    return mesh._replace(
        vertices=vertices, faces=n + np.arange(corners).reshape(mesh.faces.shape)
    )


def doubled(mesh: Broken) -> Broken:
    copy = np.random.default_rng(0).integers(0, 2, mesh.faces.shape)
    n = len(mesh.vertices)
    return mesh._replace(
        vertices=np.concatenate([mesh.vertices, mesh.vertices]),
        faces=mesh.faces + n * copy,
    )


def nearly_doubled(mesh: Broken) -> Broken:
    """Copies off by rounding, as of a texture seam in single precision."""
    found = doubled(mesh)
    vertices = found.vertices.copy()
    vertices[len(mesh.vertices) :] += 1e-9 * RNG.normal(size=mesh.vertices.shape)
    return found._replace(vertices=vertices)


def degenerate(mesh: Broken) -> Broken:
    n = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, np.repeat(mesh.vertices[:1], 2, axis=0)])
    faces = np.concatenate([[[3, 3, 5]], mesh.faces, [[7, 7, 7], [n, n + 1, 9]]])
    return mesh._replace(vertices=vertices, faces=faces)


def copies(mesh: Broken) -> Broken:
    return mesh._replace(
        faces=np.concatenate([mesh.faces, mesh.faces[4:30, [1, 2, 0]]])
    )


def turned_copies(mesh: Broken) -> Broken:
    return mesh._replace(faces=np.concatenate([mesh.faces, mesh.faces[4:30, ::-1]]))


def some_turned(mesh: Broken) -> Broken:
    turned = np.random.default_rng(1).random(len(mesh.faces)) < 0.1
    return mesh._replace(
        faces=np.where(turned[:, None], mesh.faces[:, [1, 0, 2]], mesh.faces)
    )


def half_turned(mesh: Broken) -> Broken:
    turned = np.random.default_rng(2).random(len(mesh.faces)) < 0.6
    return mesh._replace(
        faces=np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    )


def specks(mesh: Broken) -> Broken:
    """Small components inside, before all else."""
    speck = 0.01 * V[:12] + 0.1
    vertices = np.concatenate([speck, speck + 0.2, mesh.vertices])
    small = trimesh.creation.icosahedron().faces
    faces = np.concatenate([small, small + 12, mesh.faces + 24])
    return mesh._replace(vertices=vertices, faces=faces, numbers=mesh.numbers + 24)


def shuffled(mesh: Broken) -> Broken:
    order = np.random.default_rng(3).permutation(len(mesh.faces))
    faces = np.roll(mesh.faces[order], 1, axis=1)
    return mesh._replace(faces=faces)


def tiny(mesh: Broken) -> Broken:
    return mesh._replace(vertices=1e-9 * mesh.vertices, scale=1e-9)


def huge(mesh: Broken) -> Broken:
    return mesh._replace(vertices=1e9 * mesh.vertices, scale=1e9)


def far_away(mesh: Broken) -> Broken:
    """By 1e7 sizes, in micrometres."""
    shift = np.array([1.0, -0.3, 0.7]) * 2e7
    vertices = 1e-6 * (mesh.vertices + shift)
    return mesh._replace(vertices=vertices, scale=1e-6, shift=shift)


def surveyed(mesh: Broken) -> Broken:
    """UTM coordinates."""
    shift = np.array([5e5, 5.2e6, 350.0])
    return mesh._replace(vertices=mesh.vertices + shift, shift=shift)


FAULTS = [
    unused,
    unused_nan,
    with_nan_triangles,
    soup,
    doubled,
    nearly_doubled,
    degenerate,
    copies,
    turned_copies,
    some_turned,
    half_turned,
    specks,
    shuffled,
]
PLACES = [tiny, huge, far_away, surveyed]
PAIRS = [
    *itertools.combinations([unused, doubled, degenerate, some_turned, specks], 2),
    (with_nan_triangles, copies),
    (copies, some_turned),
    *((fault, place) for fault in (soup, specks, half_turned) for place in PLACES),
]
ZOO = {fault.__name__: (fault,) for fault in [*FAULTS, *PLACES]}
ZOO |= {f"{a.__name__}, {b.__name__}": (a, b) for a, b in PAIRS}


def broken(faults) -> Broken:
    mesh = SOUND
    for fault in faults:
        mesh = fault(mesh)
    return mesh


def _ply(extra=(), kind="double", index="int", quads=False) -> str:
    head = ["ply", "format ascii 1.0", f"element vertex {N}"]
    head += [f"property {kind} {axis}" for axis in "xyz"]
    head += [f"property {kind} {name}" for name in extra]
    head += [f"element face {len(F)}", f"property list uchar {index} vertex_indices"]
    more = RNG.random((N, len(extra)))
    rows = [" ".join(map(repr, row)) for row in np.c_[W, more].tolist()]
    faces = ["3 " + " ".join(map(str, row)) for row in F.tolist()]
    return "\n".join([*head, "end_header", *rows, *faces, ""])


def _obj_colours() -> str:
    rows = np.c_[W, RNG.random(W.shape)]
    return "\n".join(lines("v", rows) + lines("f", F + 1))


def _obj_dialect() -> str:
    """Weights, comments, groups, Windows' line ends, numbers from the end."""
    rows = lines("v", np.c_[W, np.ones(N)])
    faces = [f"f {a - N}/1/{a - N} {b - N}//{b - N} {c - N}" for a, b, c in F.tolist()]
    head = ["# made by a scanner", "mtllib a.mtl", "o face", "g all"]
    return "\r\n".join([*head, *rows, "vt 0 0", "usemtl skin", "s off", *faces, ""])


def _obj_quads() -> str:
    """Two triangles in one polygon, where they are flat enough for either cut: cut again
    as they were, from the first corner."""
    left, text = [t for t in F.tolist()], lines("v", W)
    while left:
        a, b, c = left.pop(0)
        for i, other in enumerate(left):
            shared = {a, c} <= set(other)
            if shared:
                (d,) = set(other) - {a, c}
                text.append(f"f {a + 1} {b + 1} {c + 1} {d + 1}")
                left.pop(i)
                break
        else:
            text.append(f"f {a + 1} {b + 1} {c + 1}")
    return "\n".join(text)


def _off() -> str:
    rows = [" ".join(map(repr, row)) for row in W.tolist()]
    faces = ["3 " + " ".join(map(str, row)) for row in F.tolist()]
    return "\n".join(["OFF", f"{N} {len(F)} 0", *rows, *faces, ""])


FILES = {
    "plain.ply": _ply(),
    "colours.ply": _ply(extra=("nx", "ny", "nz", "quality")),
    "unsigned.ply": _ply(index="uint"),
    "colours.obj": _obj_colours(),
    "dialect.obj": _obj_dialect(),
    "quads.obj": _obj_quads(),
    "plain.off": _off(),
}
EXPORTS = ["single.ply", "binary.stl", "scene.glb", "text.obj"]
