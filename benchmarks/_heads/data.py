"""The heads: what a method may see, and the truth it is scored against."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh


@dataclass(frozen=True)
class Task:
    """One source, one target, pairs of landmarks: all that a method may see."""

    source: trimesh.Trimesh
    target: trimesh.Trimesh
    vertices: np.ndarray
    """Of the source which are landmarks."""
    positions: np.ndarray
    """Of the landmarks on the target."""


class Heads:
    def __init__(self, name: str):
        folder = Path(os.environ.get("MANIREG_DATA", "../shared/data"))
        path = folder / f"{name}_heads.npz"
        if not path.exists():
            raise SystemExit(
                f"{path} is missing: set MANIREG_DATA to the folder of the head files."
            )
        self._arrays = np.load(path)
        vertices = self._arrays["vertices"].astype(float)
        self.source = trimesh.Trimesh(vertices, self._arrays["faces"], process=False)

    def task(self, target: int, landmarks: int) -> Task:
        every = landmarks == len(self._arrays["landmarks"])
        chosen = slice(None) if every else self._arrays["landmarks_sparse"]
        vertices = self._arrays["landmarks"].astype(int)[chosen]
        if len(vertices) != landmarks:
            raise SystemExit(f"there are no {landmarks} landmarks; 55 or 20.")
        name = f"target{target:02d}"
        mesh = trimesh.Trimesh(
            self._arrays[f"{name}_vertices"].astype(float),
            self._arrays[f"{name}_faces"],
            process=False,
        )
        positions = self._arrays["target_landmarks"][target].astype(float)[chosen]
        return Task(self.source, mesh, vertices, positions)

    def errors(self, target: int, vertices: np.ndarray) -> np.ndarray:
        """Distance of every vertex to where it belongs, in millimetres."""
        truth = self._arrays["ground_truth"][target]
        return np.linalg.norm(vertices - truth, axis=1)

    def scores(self, errors: np.ndarray) -> dict[str, float]:
        """Means by area: over the whole head, the face's interior, and near landmarks."""
        area = self._arrays["vertex_area"]
        parts = {"whole": np.ones(len(area), bool)}
        parts |= {name: self._arrays[name] for name in ("interior", "near_landmarks")}
        return {n: float(np.average(errors[p], weights=area[p])) for n, p in parts.items()}
