"""What `register` returns: a map between surfaces, vertex by vertex."""

from pathlib import Path

import equinox as eqx
import numpy as np
import trimesh
from jaxtyping import Float, Int

from .._files import save
from .._selection.choice import CrossValidation
from .._solver.model import RegressionMap
from ..manifolds._scans.surface import Surface
from .certificate import Certificate
from .certify import certificate_of
from .held_out import HeldOut


class Registration(eqx.Module):
    """Where every vertex of the source belongs on the target."""

    vertices: Float[np.ndarray, "n 3"]
    """On the target, numbered as the vertices of the source are in its mesh or file; a
    vertex that no triangle uses, or only those of a component left out, goes with the
    nearest one that is used."""
    model: RegressionMap
    """The map itself, for any point of the source."""
    cv: CrossValidation | None
    """How lambda was chosen; None if it was given, or not left out for (`surface`)."""
    landmark_errors: Float[np.ndarray, " l"]
    """Distances on the target between where the landmarks are sent and belong."""
    match_weights: Float[np.ndarray, " n"] | None
    """Of a map fitted to the whole target: how far each vertex has a match there, 1, or is
    an outlier or beyond its edge, 0."""
    source: Surface
    target: Surface
    held_out: HeldOut | None = None
    """With `surface="auto"`: errors of landmarks left out, with and without the rest of
    the surface."""
    landmark_names: tuple[str, ...] = eqx.field(static=True, default=())
    """Of the pairs fitted, in the order of `landmark_errors`."""

    def save(self, path: str | Path) -> None:
        """To an `.npz` file that `mr.load` reads, as `RegressionMap.save`."""
        save(self, path)

    @property
    def source_vertices(self) -> Float[np.ndarray, "n 3"]:
        return self.source.places

    @property
    def faces(self) -> Int[np.ndarray, "f 3"] | None:
        return self.source.faces

    def report(self, inverse: "Registration | None" = None) -> Certificate:
        """How good it is: folds, stretches, distances both ways, landmarks left out, 95 %
        radii; see `Certificate`. Half a minute for 20,000 vertices.

        - `inverse`: the registration of the target onto the source, `register(target,
          source, target_landmarks, source_landmarks)`, to go there and back.

        **Raises** ValueError for an `inverse` of other surfaces."""
        if inverse is not None:
            ours, theirs = inverse.target.places, inverse.source.places
            same = np.array_equal(ours, self.source.places)
            if not (same and np.array_equal(theirs, self.target.places)):
                raise ValueError(
                    "inverse: not from this target onto this source; give "
                    "`register(target, source, ...)` of the same two surfaces."
                )
        return certificate_of(
            self.model,
            self.vertices,
            self.source,
            self.target,
            len(self.landmark_errors),
            self.match_weights,
            None if inverse is None else inverse.model,
        )

    def mesh(self, t: float = 1.0) -> trimesh.Trimesh:
        """The source's triangles at (1 - t) source + t target: t = 1 is the registered
        mesh, 0.5 the morph half way, t > 1 a caricature. To write it far from the origin
        without loss take `manireg.meshes.write_mesh`."""
        if self.faces is None:
            raise ValueError("mesh: the source is a point cloud without triangles.")
        between = (1 - t) * self.source_vertices + t * self.vertices
        return trimesh.Trimesh(between, self.faces, process=False)

    def stretch(self) -> Float[np.ndarray, " f"]:
        """Area of each triangle on the target relative to its area on the source."""
        return self.mesh(1.0).area_faces / np.maximum(self.mesh(0.0).area_faces, 1e-300)
