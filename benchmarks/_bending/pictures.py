"""Pictures of `bending.py`: source, our image and the thin-plate spline's by error."""

from pathlib import Path

import numpy as np
import trimesh

from manireg import plot

from .data import Data, errors, make_data, mean
from .runs import Task

SHOWN = ("linear", "thin plate", "intrinsic")
VIEW = {"view": (0.45, 0.5, 1.0), "up": (0.0, 1.0, 0.0)}


def write_picture(out: Path, shape: str, k: int) -> bool:
    """`bending_<shape>.png` of seed 0; False if a run is missing."""
    files = {m: Task(shape, k, 0, m).image_file(out) for m in SHOWN}
    if not all(file.exists() for file in files.values()):
        return False
    data = make_data(shape, k, 0)
    images = {m: np.load(file).astype(float) for m, file in files.items()}
    wrong = {m: errors(data, image)[0] for m, image in images.items()}
    limit = float(np.percentile(wrong["thin plate"], 98))
    picture = plot.figure(7.2, 2.4)
    panels = picture.subplots(1, 1 + len(SHOWN))
    plot.surface(panels[0], two_sided(data, data.vertices), **VIEW)
    panels[0].set_title(f"source\n{k} landmarks")
    for ax, method in zip(panels[1:], SHOWN, strict=True):
        values = wrong[method][data.faces].mean(axis=1)
        mesh = two_sided(data, images[method])
        plot.surface(ax, mesh, np.tile(values, 2), (0.0, limit), **VIEW)
        ax.set_title(f"{method}\n{1000 * mean(data, wrong[method]):.1f}/1000")
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    scale = ScalarMappable(Normalize(0, limit), "viridis")
    picture.colorbar(scale, ax=list(panels), shrink=0.6).set_label("error / size")
    plot.save(picture, out / f"bending_{shape}.png")
    return True


def two_sided(data: Data, vertices: np.ndarray) -> trimesh.Trimesh:
    """Sheets are seen from both sides, so each triangle is there in both orientations."""
    faces = np.concatenate([data.faces, data.faces[:, ::-1]])
    return trimesh.Trimesh(vertices, faces, process=False)
