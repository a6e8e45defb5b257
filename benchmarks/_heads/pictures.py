"""Heat maps of the errors, like Figure 3 of the paper, and a morph half way."""

from pathlib import Path

import matplotlib
import numpy as np
import trimesh

from manireg.datasets import heads
from manireg.plot import surface

from .runs import scores

SHOWN = ("rkhs_warp", "nricp_sumner", "rbf_r", "manireg_tension")
TITLES = ("RKHS warp", "nricp_sumner", "RBF, r", "manireg")
LIMIT = 5.0  # mm
TARGET = 1


def write_pictures(out: Path) -> None:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    for data in ("ict", "makehuman"):
        files = [
            out / "heads_vertices" / f"{data}_{method}_{TARGET}.npy" for method in SHOWN
        ]
        if not all(file.exists() for file in files):
            continue
        pair = heads(data, TARGET)
        source = pair.source
        images = [np.load(file).astype(float) for file in files]
        figure, axes = plt.subplots(2, 4, figsize=(10, 6), layout="constrained")
        for ax, image, title in zip(axes[0], images, TITLES, strict=True):
            errors = np.linalg.norm(image - pair.truth, axis=1)
            surface(ax, source, errors, (0.0, LIMIT), colours="magma")
            mean = scores(pair, errors)
            ax.set_title(f"{title}\n{mean['whole']:.2f} / {mean['interior']:.2f} mm")
        scale = matplotlib.cm.ScalarMappable(
            matplotlib.colors.Normalize(0, LIMIT), "magma"
        )
        bar = figure.colorbar(scale, ax=list(axes[0]), shrink=0.8)
        bar.set_label("error, mm")
        half = 0.5 * np.asarray(source.vertices) + 0.5 * images[-1]
        meshes = {
            "source": source,
            "morph 50 %": trimesh.Trimesh(half, source.faces, process=False),
            "registered": trimesh.Trimesh(images[-1], source.faces, process=False),
            "target": pair.target,
        }
        for ax, (title, mesh) in zip(axes[1], meshes.items(), strict=True):
            surface(ax, mesh)
            ax.set_title(title)
        figure.savefig(out / f"heads_{data}.png", dpi=110)
        plt.close(figure)
