"""Pictures of triangle meshes, drawn by matplotlib without a screen."""

from typing import Any

import numpy as np

from ._figure import Axes, Figure, figure, figure_of, matplotlib


def surface(
    ax: Axes,
    mesh: Any,
    values: Any = None,
    limits: tuple[float, float] = (0.0, 1.0),
    *,
    colours: str = "viridis",
    view: tuple[float, float, float] = (0.3, 0.2, 1.0),
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> None:
    """Draw `mesh` (a `trimesh.Trimesh`) as seen from direction `view`, shaded; a value for
    each triangle (or one for each vertex) gives its colour between `limits`."""
    axes = view_axes(view, up)
    vertices, normals = mesh.vertices @ axes.T, mesh.face_normals @ axes.T
    shown = np.flatnonzero(normals[:, 2] > 0)
    order = shown[np.argsort(vertices[mesh.faces[shown], 2].mean(axis=1))]
    light = np.clip(0.35 + 0.65 * normals[order] @ [0.3, 0.4, 0.866], 0, 1)[:, None]
    if values is None:
        base = np.tile([0.82, 0.80, 0.77], (len(order), 1))
    else:
        values = np.asarray(values)
        if len(values) == len(mesh.vertices):
            values = values[mesh.faces].mean(axis=1)
        share = np.clip((values[order] - limits[0]) / (limits[1] - limits[0]), 0, 1)
        base = matplotlib().colormaps[colours](share)[:, :3]
    from matplotlib.collections import PolyCollection

    paint = base * (0.25 + 0.75 * light)
    triangles = vertices[mesh.faces[order], :2]
    ax.add_collection(
        PolyCollection(triangles, facecolors=paint, edgecolors=paint, linewidths=0.2)
    )
    ax.set(aspect="equal")
    ax.set_axis_off()
    ax.autoscale_view()


def view_axes(view=(0.3, 0.2, 1.0), up=(0.0, 1.0, 0.0)) -> np.ndarray:
    """Rows: to the right, upwards, to the viewer."""
    forward = np.asarray(view, float) / np.linalg.norm(view)
    right = np.cross(up, forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def registration(found: Any, morph: float = 0.5) -> Figure:
    """Source, morph and registered surface, the last one coloured by how much the map
    stretches areas (factor, on a logarithmic scale)."""
    picture = figure(7.2, 3.0)
    panels = picture.subplots(1, 3)
    stretch = np.log2(np.maximum(found.stretch(), 1e-3))
    limit = float(np.percentile(np.abs(stretch), 98))
    titles = ("source", f"morph {100 * morph:.0f} %", "registered")
    for ax, t, title in zip(panels, (0.0, morph, 1.0), titles, strict=True):
        coloured = (stretch, (-limit, limit)) if t == 1.0 else (None, (0.0, 1.0))
        surface(ax, found.mesh(t), *coloured, colours="RdBu_r")
        ax.set_title(title)
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    scale = ScalarMappable(LogNorm(2.0**-limit, 2.0**limit), "RdBu_r")
    bar = figure_of(panels[-1]).colorbar(scale, ax=panels[-1], shrink=0.6)
    marks = [2.0**-limit, 1.0, 2.0**limit]
    bar.set_ticks(marks, labels=[f"{mark:.2f}" for mark in marks], minor=False)
    bar.minorticks_off()
    bar.set_label("area on target / source")
    return picture
