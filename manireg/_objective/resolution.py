"""Whether the basis, rather than lambda or noise, limits how fine a fit is."""

import warnings

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, ScalarLike
from scipy.spatial import KDTree

from .._discretisation.local_spacing import spacings_of
from .._sources.checks import is_concrete
from .problem import Problem, psi_at_data

SHORTEST = 2.0  # wavelength that a basis resolves, in its spacings
# Spacings of the data in one of the basis: up to that its polynomials interpolate.
INTERPOLATED = 2.5
SHARE = 0.25  # of the data: fewer are dense by chance
ALIKE = 0.1  # correlation of neighbouring residuals: less is not worth more centres
SIGNIFICANT = 5.0  # standard errors of it, of independent noise
NOTICEABLE = 1e-2  # of the data's spread: what is missed and smaller is not told


class ResolutionWarning(UserWarning):
    """The basis is too coarse for the data at this lambda: give more `centres`."""


def warn_where_coarse(
    problem: Problem,
    w: Float[Array, "KC t"],
    lam: ScalarLike,
    least: ScalarLike | None = None,
    above: int = 0,
) -> None:
    r"""A `ResolutionWarning` if the basis limits the fit with coefficients `w`:

    - a quarter of the data lie more than 2.5 times closer than its centres, and the
      wavelength of lambda there, $\ell_i = 2\pi (\lambda k h_i^m)^{1/4}$ with $h_i$
      their spacing (`lambda_grid`; evenly spread, $k h^m$ is the volume), is shorter than
      two spacings of the centres: smoothing is not what keeps the fit from the data. Of
      a lambda that was chosen that of the `least` that was tried: where the basis cannot
      follow the data, any lambda may be chosen;
    - and what it misses there is not noise: residuals r of nearest neighbours are alike,

      $$c = \sum_i \langle r_i, r_{j(i)}\rangle \Big/ \sum_i |r_i|^2$$

      is above 0.1 and five standard errors (it is about 0 for independent noise, however
      small lambda, and near 1 where detail is averaged out), and the root mean square of
      what they share, $\sqrt c$ times that of r, above a hundredth of the data's spread.

    Silent for traced problems or lambdas. `above`: calls between the function that asks
    and the one that its user called; the warning names the user's line."""
    if not is_concrete(lam, w, problem.x, problem.y, problem.weights):
        return
    x, y, residuals = _distinct(problem, w)
    if len(x) < 2:
        return
    m = problem.dim
    coarse, h, spacing = _coarse(problem, x, lam if least is None else least)
    if np.mean(coarse) < SHARE or not _alike(x, y, residuals(), coarse):
        return
    finer = np.median((spacing / (INTERPOLATED * h))[coarse])
    centres = len(problem.basis.centres)
    warnings.warn(
        f"centres: the basis limits the fit, not lam = {float(np.asarray(lam)):.3g} or "
        f"noise: residuals of neighbouring inputs are alike, and its {centres} centres "
        f"lie {np.median(spacing[coarse]):.3g} apart at {np.sum(coarse)} of {len(x)} "
        "distinct inputs. Finer detail of the data is averaged out. Give more `centres`: "
        f"up to {_rounded(centres * finer**m)} the data resolve; or a larger `lam` if "
        "that is meant.",
        ResolutionWarning,
        stacklevel=3 + above,
    )


def unresolved(problem: Problem, lam: ScalarLike) -> int:
    """How many distinct inputs lie closer than centres and lambda resolve, as above;
    whether what is missed there is noise is not asked."""
    heavy = np.asarray(problem.weights) > 0
    x = np.unique(_inputs(problem)[heavy], axis=0)
    return int(np.sum(_coarse(problem, x, lam)[0])) if len(x) > 1 else 0


def _coarse(problem: Problem, x: Float[np.ndarray, "k s"], lam: ScalarLike):
    """At which distinct inputs the centres lie farther apart than the data and half the
    wavelength of lambda; the spacings of both there."""
    m, power = problem.dim, 1 / (2 * problem.energy.order)
    h, spacing = spacings_of(x, m), _spacings_of_centres(problem, x)
    wavelength = 2 * np.pi * (float(np.asarray(lam)) * len(x) * h**m) ** power
    coarse = spacing > np.maximum(INTERPOLATED * h, wavelength / SHORTEST)
    return coarse, h, spacing


def _distinct(problem: Problem, w):
    """Distinct inputs of positive weight, outputs there, and what gives the residuals:
    weighted means of repeated ones, as a pair given twice is no detail."""
    weights = np.asarray(problem.weights)
    heavy = weights > 0
    x, own = np.unique(_inputs(problem)[heavy], axis=0, return_inverse=True)
    total = np.bincount(own.ravel(), weights[heavy])

    def mean(values):
        sums = np.zeros((len(x), values.shape[1]))
        np.add.at(sums, own.ravel(), weights[heavy, None] * values[heavy])
        return sums / total[:, None]

    def residuals():
        psi = psi_at_data(problem, w)
        landed = problem.target.project(psi.reshape(-1, *problem.target.point_shape))
        return mean(np.asarray(jnp.reshape(landed, psi.shape) - problem.y))

    return x, mean(np.asarray(problem.y)), residuals


def _inputs(problem: Problem) -> Float[np.ndarray, "k s"]:
    """Of each row; the nodes of a latent input are no data of their own, and stand at
    their mean."""
    x = np.asarray(problem.x)
    if problem.owner is None:
        return x
    owner, weights = np.asarray(problem.owner), np.asarray(problem.weights)
    total = np.bincount(owner, weights)
    sums = [np.bincount(owner, weights * column) for column in x.T]
    return (np.stack(sums, axis=1) / np.where(total > 0, total, 1.0)[:, None])[owner]


def _spacings_of_centres(problem: Problem, x) -> Float[np.ndarray, " k"]:
    """Distance from the centre next to each input to its own next one."""
    centres = np.asarray(problem.basis.centres)
    tree = KDTree(centres)
    apart = tree.query(centres, k=2)[0][:, 1]
    return apart[tree.query(x)[1]]


def _alike(x, y, residuals, coarse: Bool[np.ndarray, " k"]) -> bool:
    """Whether the residuals of neighbours are, beyond chance, and enough to be seen."""
    x, r = x[coarse], residuals[coarse]
    squares = np.sum(r**2)
    if len(x) < 2 or not squares > 0:
        return False
    neighbour = np.asarray(KDTree(x).query(x, k=2)[1])[:, 1]
    c = np.sum(r * r[neighbour]) / squares
    spread = np.sum((y[coarse] - np.mean(y, axis=0)) ** 2)
    # mutual neighbours count twice: the variance is at most 2 / k
    beyond = max(ALIKE, SIGNIFICANT * np.sqrt(2 / len(x)))
    return bool(c > beyond and c * squares > NOTICEABLE**2 * spread)


def _rounded(n: float) -> int:
    """To two digits."""
    unit = 10 ** max(int(np.floor(np.log10(n))) - 1, 0)
    return int(round(n / unit) * unit)
