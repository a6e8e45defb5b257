"""Sliding semilandmarks: points of curves and surfaces that have a place along them only
by comparison with other specimens."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .._input.numbers import Numbers, as_numbers
from ..manifolds import PointCloud
from ..manifolds._scans.surface import SurfaceLike
from .given import given_surface
from .orientation import normals_at
from .procrustes import procrustes

PLANE = 5  # landmarks, itself included, that tell the tangent plane at one
ROUNDS = 50
SETTLED = 1e-4  # relative decrease that is not worth another round
HALVINGS = 8  # of a slide after which the energy is higher on the scan


class Slid(NamedTuple):
    """Landmarks after sliding."""

    landmarks: Float[np.ndarray, "..."]
    """Of the shape they were given in."""
    reference: Float[np.ndarray, "n s"]
    energies: Float[np.ndarray, "..."]
    """Bending energy of each specimen over the reference; one number of one specimen."""
    energies_before: Float[np.ndarray, "..."]
    rounds: int


def slide(
    landmarks: Numbers,
    curves: Numbers | None = None,
    surfaces: Numbers | None = None,
    *,
    reference: Numbers | None = None,
    scans: SurfaceLike | Sequence[SurfaceLike] | None = None,
) -> Slid:
    r"""Slide semilandmarks along tangents of their curves and surfaces to where the thin
    plate that maps the reference to the specimen bends least,

    $$\min_T\; \operatorname{tr} (Y + U T)^\top L\, (Y + U T),$$

    Y the landmarks, U the directions in which they may slide (one of a curve, two of a
    surface, none of a landmark), L the bending energy matrix of the reference: the upper
    left block of the inverse of $\begin{pmatrix} K & P \\ P^\top & 0 \end{pmatrix}$ with
    $P = (1, X)$ and $K_{ij} = -|x_i - x_j|$ in space, $r^2 \log r$ in the plane. The
    minimum is that of a linear system and is exact.

    **Arguments:**

    - `landmarks`: `(n, s)` of one specimen or `(k, n, s)` of several, s = 2 or 3, in any
      position and size: the energy sees no affine maps.
    - `curves`: `(c, 3)` numbers of landmarks from 0, before, slider, after: it slides
      along the line from the one to the other (the table of the field's programs; those
      of R count from 1).
    - `surfaces`: numbers of landmarks that slide on a surface. Without `scans` their
      tangent plane is that of the five nearest landmarks.
    - `reference`: `(n, s)`. Default of several: their Procrustes mean; sliding and
      averaging take turns while specimens come nearer to their mean (mostly once or
      twice). One specimen needs it.
    - `scans`: the surface of each specimen, as in `register`. Normals are then those of
      the surface, landmarks are put back on it after each slide, and slides are repeated
      from there while the energy falls. Without, slides are straight, once.

    **Returns:** a `Slid`: `.landmarks`, `.reference`, `.energies` and `.energies_before`
    (square of a length over that of the reference in space; their ratio has no unit),
    `.rounds` of averaging.

    A map with noise, on any manifold, does the same by its data: `make_problem(source,
    target, x, y, precision=P)` with $P = I - t t^\top$ for a curve with the tangent t, $P
    = n n^\top$ for a surface with the normal n in `Euclidean(3)`.

    **Raises** ValueError for wrong shapes and numbers, NaN, a reference in a plane (on a
    line), one specimen without a reference, landmarks that slide twice.

    ```python
    data = mr.datasets.scallops()
    slid = mr.slide(data.landmarks, data.curves, data.surfaces)
    slid.energies / slid.energies_before
    ```

    Source: Bookstein 1997, *Landmark methods for forms without landmarks* (Medical Image
    Analysis 1); Gunz, Mitteroecker and Bookstein 2005, *Semilandmarks in three dimensions*
    (Modern Morphometrics in Physical Anthropology).
    """
    given = as_numbers("landmarks", landmarks)
    if given.ndim not in (2, 3) or given.shape[-1] not in (2, 3):
        raise ValueError(
            "landmarks: expected shape (n, s) or (k, n, s) with s = 2 or 3, found "
            f"{given.shape}."
        )
    _check_finite("landmarks", given)
    before = given.reshape(-1, *given.shape[-2:])
    k, n, s = before.shape
    if reference is None and k == 1:
        raise ValueError("reference: one specimen slides onto a `reference`; give it.")
    triples = _numbers("curves", curves, (-1, 3), n)
    flat = _numbers("surfaces", surfaces, (-1,), n)
    if s == 2 and len(flat):
        raise ValueError("surfaces: landmarks in the plane slide on curves only.")
    sliders, count = np.unique(np.append(triples[:, 1], flat), return_counts=True)
    if np.any(count > 1):
        raise ValueError(
            f"curves, surfaces: landmark {sliders[count > 1][0]} slides twice."
        )
    clouds = _clouds(scans, k)

    def onto(mean):
        pairs = zip(before, clouds, strict=True)
        bending = bending_matrix(mean)
        return np.stack([_slid(bending, y, triples, flat, c) for y, c in pairs])

    if reference is None:
        mean, moved, rounds = _onto_their_mean(onto, before)
    else:
        mean, rounds = as_numbers("reference", reference), 1
        if mean.shape != (n, s):
            raise ValueError(f"reference: expected shape {(n, s)}, found {mean.shape}.")
        _check_finite("reference", mean)
        moved = onto(mean)
    energies = lambda y: np.einsum("kis,ij,kjs->k", y, bending_matrix(mean), y)
    batch = given.shape[:-2]
    after, at_first = (energies(y).reshape(batch) for y in (moved, before))
    return Slid(moved.reshape(given.shape), mean, after, at_first, rounds)


def _onto_their_mean(onto: Callable, landmarks) -> tuple[np.ndarray, np.ndarray, int]:
    """Each round lowers the energies over the mean before; without a stop means and
    specimens would go on to drift along the surface together."""
    best, rounds = procrustes(landmarks), 0
    reference, moved = best.mean, landmarks
    while rounds < ROUNDS:
        trial = onto(best.mean)
        found = procrustes(trial)
        if found.spread > (1 - SETTLED) * best.spread:
            break
        reference, moved, best, rounds = best.mean, trial, found, rounds + 1
    return reference, moved, rounds


def bending_matrix(reference: Float[np.ndarray, "n s"]) -> Float[np.ndarray, "n n"]:
    """L, whose form of landmarks is the bending energy of their thin plate."""
    n, s = reference.shape
    size = float(np.ptp(reference, axis=0).max())
    x = (reference - reference.mean(axis=0)) / size
    spread = np.linalg.svd(x, compute_uv=False)
    if n <= s + 1 or spread[-1] <= 1e-6 * spread[0]:
        where = "in a plane" if s == 3 else "on a line"
        raise ValueError(
            f"reference: {n} landmarks {where} or too few; at least {s + 2} that are not "
            "are needed."
        )
    r = np.linalg.norm(x[:, None] - x, axis=2)
    kernel = -r if s == 3 else r**2 * np.log(np.where(r > 0, r, 1.0))
    trend = np.column_stack([np.ones(n), x])
    corner = np.zeros((s + 1, s + 1))
    bordered = np.block([[kernel, trend], [trend.T, corner]])
    if np.linalg.cond(bordered) > 1e14:
        raise ValueError("reference: two of its landmarks are at one place.")
    whole = np.linalg.inv(bordered)[:n, :n]
    return 0.5 * (whole + whole.T) / size ** (4 - s)


def _slid(bending, y, curves, flat, cloud: PointCloud | None):
    """One specimen."""
    if cloud is None:
        return y + _step(bending, y, _directions(y, curves, flat, None), curves, flat)
    sliders = np.append(curves[:, 1], flat)
    energy = lambda y: np.einsum("is,ij,js->", y, bending, y)
    best = energy(y)
    for _ in range(ROUNDS):
        step = _step(bending, y, _directions(y, curves, flat, cloud), curves, flat)
        for halving in range(HALVINGS):
            trial = y + step / 2**halving
            trial[sliders] = np.asarray(cloud.project(jnp.asarray(trial[sliders])))
            if energy(trial) < best:
                break
        else:
            return y
        last, best, y = best, energy(trial), trial
        if last - best <= SETTLED * last:
            return y
    return y


def _directions(y, curves, flat, cloud: PointCloud | None):
    """Unit vectors in which points slide: of curves `(c, s)`, of surfaces `(f, 2, 3)`."""
    along = y[curves[:, 2]] - y[curves[:, 0]]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    if not len(flat):
        return along, np.zeros((0, 2, 3))
    if cloud is not None:
        normals = normals_at(cloud, y[flat])
        return along, np.linalg.svd(normals[:, None])[2][:, 1:]
    near = np.argsort(np.linalg.norm(y[flat, None] - y, axis=2), axis=1)[:, :PLANE]
    offset = y[near] - y[near].mean(axis=1, keepdims=True)
    return along, np.linalg.svd(offset)[2][:, :2]


def _step(bending, y, directions, curves, flat):
    """The slide to the minimum, the shortest where it is not the only one."""
    along, planes = directions
    rows = np.concatenate([curves[:, 1], np.repeat(flat, 2)])
    vectors = np.concatenate([along, planes.reshape(-1, y.shape[1])])
    pull = -np.einsum("rs,rs->r", vectors, (bending @ y)[rows])
    form = bending[np.ix_(rows, rows)] * (vectors @ vectors.T)
    length = np.linalg.pinv(form, 1e-12, hermitian=True) @ pull
    step = np.zeros_like(y)
    np.add.at(step, rows, length[:, None] * vectors)
    return step


def _clouds(scans, k: int) -> list[PointCloud | None]:
    if scans is None:
        return [None] * k
    several = list(scans) if isinstance(scans, list | tuple) else [scans]
    if len(several) != k:
        raise ValueError(f"scans: expected {k}, one a specimen, found {len(several)}.")
    return [given_surface(f"scans[{i}]", a).cloud for i, a in enumerate(several)]


def _numbers(name: str, given, shape, n: int) -> Int[np.ndarray, "..."]:
    array = np.zeros((0, *shape[1:]), int) if given is None else np.asarray(given)
    good = array.ndim == len(shape) and array.shape[1:] == shape[1:]
    if not good or array.dtype.kind not in "iu":
        raise ValueError(
            f"{name}: expected whole numbers of shape {str(shape).replace('-1', 'c')}, "
            f"found {array.dtype} of shape {array.shape}."
        )
    wrong = array[(array < 0) | (array >= n)]
    if len(wrong):
        raise ValueError(
            f"{name}: landmark {wrong[0]} does not exist; there are {n}, numbered from 0."
        )
    return array.astype(int)


def _check_finite(name: str, values) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        raise ValueError(f"{name}: NaN or infinity, first at {tuple(bad[0].tolist())}.")
