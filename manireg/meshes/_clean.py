"""The surface a triangle mesh stands for: its points, its triangles, which side is out."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from ._components import areas_of, components_of, restricted
from ._edges import connected, crowded_edges, open_edges, shared_edges, sides_of
from ._mesh import as_mesh
from ._report import Finding, Report, found
from ._weld import Welded, places, weld
from ._winding import against_the_others

LEAST_SHARE = 0.01  # of the area: smaller components are left out


class MeshSurface(NamedTuple):
    """Points, normals and areas of a surface, and where each vertex of the mesh is."""

    points: Float[np.ndarray, "P 3"]
    normals: Float[np.ndarray, "P 3"]
    areas: Float[np.ndarray, " P"]
    """A third of the triangles around each point."""
    triangles: Int[np.ndarray, "T 3"]
    of_vertex: Int[np.ndarray, " n"]
    """The point each vertex of the mesh is; the nearest, where no triangle uses it."""
    components: int
    report: Report


def mesh_surface(mesh, least_share: float = LEAST_SHARE) -> MeshSurface:
    """Of a mesh or a file: what `manireg.load_surface` does with one. Components of less
    than `least_share` of the area are left out, at 1 all but the largest."""
    mesh = as_mesh(mesh)
    welded = weld(mesh)
    part = components_of(welded)
    shares = np.bincount(part, areas_of(welded.x[welded.triangles]))
    shares = shares / shares.sum()
    dropped = shares < least_share
    dropped[0] = False
    welded = restricted(welded, ~dropped[part])
    turn = against_the_others(welded)
    wound = np.where(turn[:, None], welded.triangles[:, ::-1], welded.triangles)
    findings = [*welded.findings, *_parts(shares, dropped, least_share)]
    findings += found(
        "triangles wound against their neighbours",
        welded.faces[turn],
        "turned around",
        notable=True,
    )
    findings += _edges(wound, len(welded.x))
    vertex = _in_order(welded, wound)
    number = np.full(len(welded.x), -1)
    number[vertex] = np.arange(len(vertex))
    triangles, x = _canonical(number[wound]), welded.x[vertex]
    normals, areas = _normals_and_areas(x, triangles)
    of_vertex, stray = _points_of(welded, number, vertex, np.asarray(mesh.faces))
    findings += found(
        "vertices of no triangle that is kept",
        stray,
        "in results each goes with the nearest",
    )
    vertices = np.asarray(mesh.vertices, dtype=float)
    report = Report(len(vertices), len(mesh.faces), welded.size, tuple(findings))
    return MeshSurface(
        vertices[vertex],
        normals,
        areas * welded.size**2,
        triangles,
        of_vertex,
        int(np.sum(~dropped)),
        report,
    )


def _parts(shares, dropped, least_share) -> list[Finding]:
    kept, lost = np.sum(~dropped), shares[dropped]
    findings = []
    if kept > 1:
        listed = ", ".join(f"{100 * s:.3g} %" for s in shares[~dropped][:5])
        more = ", ..." if kept > 5 else ""
        done = f"kept ({listed}{more} of the area)"
        findings.append(Finding("components that do not touch", int(kept), None, done))
    if len(lost):
        done = f"left out ({100 * lost.sum():.2g} % in all)"
        fault = f"components of less than {100 * least_share:g} % of the area"
        findings.append(Finding(fault, len(lost), None, done, notable=True))
    return findings


def _edges(triangles, n: int) -> list[Finding]:
    sides = sides_of(triangles)
    crowded, ends = crowded_edges(sides), open_edges(sides)
    findings = found(
        "edges of three triangles or more",
        crowded.ravel()[: len(crowded)],
        "as they are; their triangles may be on different sides",
    )
    _, pair, agree = shared_edges(sides)
    if not np.all(agree):
        findings += found(
            "edges where the surface has one side only",
            triangles[pair[~agree, 0], 0],
            "as they are",
            notable=True,
        )
    if len(ends):
        used = np.unique(ends)
        loops = len(np.unique(connected(ends, n)[used]))
        done = f"as they are, in {loops} {'rims' if loops > 1 else 'rim'}"
        findings.append(Finding("open edges", len(ends), None, done))
    return findings


def _in_order(welded: Welded, triangles) -> Int[np.ndarray, " P"]:
    """The vertices in use, in the order of the first of all vertices at their places: the
    same points in the same order, whichever of two copies triangles take."""
    vertex = np.unique(triangles)
    placed = np.flatnonzero(welded.placed)
    group = places(welded.x[placed])
    first = np.full(group.max() + 1, len(welded.x))
    np.minimum.at(first, group, placed)
    at = first[group[np.searchsorted(placed, vertex)]]
    return vertex[np.lexsort((vertex, at))]


def _canonical(triangles) -> Int[np.ndarray, "T 3"]:
    """From their lowest corner, in the order of corners: rounding does not depend on how
    a file lists them."""
    lowest = np.argmin(triangles, axis=1)[:, None]
    rolled = np.take_along_axis(triangles, (lowest + np.arange(3)) % 3, axis=1)
    return rolled[np.lexsort(rolled.T[::-1])]


def _points_of(welded: Welded, number, vertex, faces):
    """The point of each vertex, and the vertices that have none of their own."""
    of_vertex = number[welded.same]
    stray = np.flatnonzero(of_vertex < 0)
    x = welded.x[vertex]
    lost = np.flatnonzero(~welded.placed)
    if len(stray):
        of_vertex[stray] = KDTree(x).query(welded.x[stray])[1]
    if len(lost):  # without a place: with a corner of one of their triangles
        beside = faces[np.any(~welded.placed[faces], axis=1)]
        for here in range(3):
            for there in range(3):
                ours, other = beside[:, here], beside[:, there]
                good = ~welded.placed[ours] & welded.placed[other]
                of_vertex[ours[good]] = of_vertex[other[good]]
    return of_vertex, np.setdiff1d(stray, lost)


def _normals_and_areas(x, triangles):
    """Normals are means over the angles around a point, or where triangles lie back to
    back and cancel that of one of them; not normalised."""
    corners = x[triangles]
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    doubled = np.cross(ahead[:, 0], back[:, 0])
    size = np.linalg.norm(doubled, axis=1)
    cosine = np.sum(ahead * back, axis=2)
    angle = np.arctan2(size[:, None], cosine)
    normal = doubled / size[:, None]
    share = angle[:, :, None] * normal[:, None]
    index, P = triangles.ravel(), len(x)
    sums = [np.bincount(index, s, minlength=P) for s in share.reshape(-1, 3).T]
    angles = np.bincount(index, angle.ravel(), minlength=P)
    areas = np.bincount(index, np.repeat(size / 6, 3), minlength=P)
    normals = np.stack(sums, axis=1) / angles[:, None]
    lost = np.linalg.norm(normals, axis=1) < 1e-6
    some = np.zeros(P, int)
    some[index] = np.repeat(np.arange(len(triangles)), 3)
    normals[lost] = normal[some[lost]]
    return normals, areas
