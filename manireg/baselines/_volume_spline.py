"""The spline of space through the landmarks, then the closest point."""

from scipy.interpolate import RBFInterpolator

from .._input.numbers import Numbers
from .._input.precision import check_x64
from ..manifolds import PointCloud
from ._surface_warp import SurfaceWarp, checked_task, surface_warp


def volume_spline(
    source_vertices: Numbers,
    source_landmarks: Numbers,
    target_landmarks: Numbers,
    target: PointCloud,
    *,
    kernel: str = "linear",
    smoothing: float = 0.0,
) -> SurfaceWarp:
    r"""$f(x) = A x + b + \sum_i a_i\, \phi(|x - X_i|)$ through the landmarks,
    $f(X_i) = Y_i$, then the closest point on the target.

    `kernel="linear"`, $\phi(r) = r$: the biharmonic spline of space, the least
    $\int |D^2 f|^2$ over $\mathbb{R}^3$. The strong baseline of surface registration:
    on open heads nothing as simple comes near it. `kernel="thin_plate_spline"`,
    $\phi(r) = r^2 \log r$: the biharmonic spline of the *plane* applied in space, as is
    often done.

    The method knows neither surface before the last step: parts far apart along the
    surface but near in space (lips, lids) move together, and closest points may fold.
    The comparison "TPS" of Steinke and Hein 2008, section 5, is of this kind, with
    another bending energy: `projected_thin_plate`, an integral over the surface.

    **Arguments:**

    - `source_vertices`: `(n, 3)`, what to send to the target.
    - `source_landmarks`, `target_landmarks`: `(l, 3)`, positions of at least 5 pairs.
    - `target`: a `PointCloud`, e.g. `PointCloud.from_mesh(mesh)`.
    - `smoothing`: 0 interpolates; for noisy landmarks see scipy's `RBFInterpolator`,
      which does the work, and `held_out_errors`.

    **Example:**

    ```python
    ball = trimesh.creation.icosphere(subdivisions=2)
    egg = mr.PointCloud.from_mesh(ball.copy().apply_scale([1.0, 1.2, 0.8]))
    marks = np.arange(0, 162, 15)
    warp = mr.baselines.volume_spline(
        ball.vertices, ball.vertices[marks], egg.points[marks], egg
    )
    warp.vertices.shape  # 162, 3
    ```
    """
    check_x64(target)
    if kernel not in ("linear", "thin_plate_spline"):
        raise ValueError(
            f"kernel: expected 'linear' or 'thin_plate_spline', found {kernel!r}."
        )
    if not 0 <= smoothing < float("inf"):
        raise ValueError(f"smoothing: must be 0 or positive, found {smoothing}.")
    vertices, x, y = checked_task(
        source_vertices, source_landmarks, target_landmarks, target
    )
    spline = RBFInterpolator(x, y, kernel=kernel, degree=1, smoothing=smoothing)
    return surface_warp(target, spline, vertices)
