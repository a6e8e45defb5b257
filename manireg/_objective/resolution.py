"""Whether the basis, rather than lambda, limits how fine a fit can be."""

import warnings

import numpy as np
from jaxtyping import Float, ScalarLike
from scipy.spatial import KDTree

from .._discretisation.local_spacing import spacings_of
from .._sources.checks import is_concrete
from .problem import Problem

SHORTEST = 2.0  # wavelength that a basis resolves, in its spacings
# Spacings of the data in one of the basis: up to that its polynomials interpolate.
INTERPOLATED = 2.5
SHARE = 0.25  # of the data: fewer are dense by chance


class ResolutionWarning(UserWarning):
    """The basis is too coarse for the data at this lambda: give more `centres`."""


def warn_where_coarse(problem: Problem, lam: ScalarLike) -> None:
    r"""A `ResolutionWarning` if for a quarter of the data the basis limits the fit: they
    lie more than 2.5 times closer than its centres, and the wavelength of lambda there,

    $$\ell_i = 2\pi (\lambda k h_i^m)^{1/4},$$

    with $h_i$ their spacing (`lambda_grid`; evenly spread, $k h^m$ is the volume), is
    shorter than two spacings of the centres. Silent for traced problems or lambdas."""
    if not is_concrete(lam, problem.x, problem.basis.centres):
        return
    m = problem.dim
    data = np.unique(np.asarray(problem.x), axis=0)
    wanted, spacing = _wanted_spacings(problem, data, float(np.asarray(lam)), m)
    coarse = spacing > wanted
    if np.mean(coarse) < SHARE:
        return
    finer = np.median((spacing / wanted)[coarse])
    centres = len(problem.basis.centres)
    warnings.warn(
        f"centres: at {np.sum(coarse)} of {len(data)} distinct inputs the basis limits "
        f"the fit, not lam = {float(np.asarray(lam)):.3g}: its {centres} centres lie "
        f"{np.median(spacing[coarse]):.3g} apart there, {finer:.1f} times too far for the "
        "data and this lambda. Finer detail of the data is averaged out. Give more "
        "`centres`, or a larger `lam` if that is meant.",
        ResolutionWarning,
        stacklevel=3,
    )


def _wanted_spacings(
    problem: Problem, data: Float[np.ndarray, "k s"], lam: float, m: int
):
    """The largest spacing of centres that does not limit the fit at each datum, and the
    one there is."""
    h = spacings_of(data, m)
    root = 1 / (2 * problem.energy.order)
    wavelength = 2 * np.pi * (lam * len(data) * h**m) ** root
    centres = np.asarray(problem.basis.centres)
    tree = KDTree(centres)
    apart = tree.query(centres, k=2)[0][:, 1]
    spacing = apart[tree.query(data)[1]]
    return np.maximum(INTERPOLATED * h, wavelength / SHORTEST), spacing
