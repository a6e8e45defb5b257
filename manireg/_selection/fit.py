"""The one-call path."""

from typing import Any, Literal

from .._input.numbers import Numbers
from .._objective.robust import AbstractLoss
from .._solver.model import RegressionMap
from .._source import AbstractSource
from ..manifolds import AbstractManifold
from .chosen_fit import chosen_fit
from .criteria import CriterionName
from .noise import Scatter
from .orders import Order


def fit(
    source: AbstractSource,
    target: AbstractManifold,
    x: Numbers,
    y: Numbers,
    lam: Numbers | None = None,
    *,
    wavelength: Numbers | None = None,
    weights: Numbers | None = None,
    sigma: Numbers | None = None,
    precision: Numbers | None = None,
    frames: Numbers | None = None,
    scatter: Scatter = "additive",
    x_sigma: Numbers | None = None,
    x_min: Numbers | None = None,
    x_max: Numbers | None = None,
    x_error: Literal["latent", "effective"] = "latent",
    loss: AbstractLoss | str = "squared",
    centres: int | None = None,
    degree: int | None = None,
    width: float | None = None,
    graded: bool = False,
    tension: float = 0.0,
    order: Order = 2,
    distance: Literal["chord", "geodesic"] = "chord",
    criterion: CriterionName = "error",
    folds: int | None = None,
    **options,
) -> RegressionMap:
    r"""Learn a smooth map `source -> target` from pairs (x_i, y_i):

    $$\min_\Psi \; \frac{\sum_i w_i \rho(q_i d_N(y_i, \Psi(x_i))^2)}{\sum_i w_i}
    + \lambda \int_M |\nabla^{p-1} d\Psi|^2$$

    with relative precisions $q_i$ of mean 1 and the identity for $\rho$, unless they are
    given.

    **Arguments:** `source`, `target`, `x`, `y`, `weights`, `sigma`, `precision`, `frames`,
    `loss`, `centres`, `degree`, `width`, `graded`, `tension` as in `make_problem`; `order`
    p as there (default 2, the Eells energy), or without `lam` several, `(2, 3)` or
    `"auto"`, to choose from; `lam` lambda, or None to choose it; other options go to
    `solve` (with `lam`), `leave_one_out` or `cross_validate` (without).

    - `wavelength`: lambda by a length in the unit of x, such as 40 of ages in millions of
      years: waves of that length keep half of their height, longer ones more. As in
      `solve`, $\lambda = (\ell / 2\pi)^{2p} / V$. Of a chosen lambda it is
      `model.summary().wavelength`.
    - `scatter`: what is done where data scatter more than `sigma` or `precision` say.
      `"additive"` (default): $\sigma_i^2 + \tau^2$, with $\tau$ by restricted likelihood
      (0 where they do not); `"factor"`: all variances times $\varphi$, the reduced
      $\chi^2$; `"none"`: what was given is believed. `model.summary()` tells both, and
      under which of them left-out data are likelier.
    - `x_sigma`, or `x_min` and `x_max`: `(k,)` or one number each, of inputs on an
      `Interval` that are known within errors: the standard deviation of a normal
      distribution around `x`, or the ends of a uniform one; or all three, `(k,)`, with
      NaN in `x_sigma` where a range is meant and in both ends where a deviation (0 of an
      exact input). `x_error` says how: `"latent"`
      (default): true inputs are unknowns with that prior, within the interval, and the
      map the one of the largest marginal likelihood; lambda, if not given, by restricted
      likelihood (see `manireg._selection.latent_inputs`). `"effective"`: errors are added
      to those of the outputs along the velocity; quicker, but the map stays flattened
      where it bends within the errors.
    - `loss`: a robust one whose data have no `sigma` is given its scale from them:
      squared first, then with the scale of the residuals (see
      `manireg._selection.noise`), each fit started from the one before, until that stays
      to 0.3 %. `model.data_weights` are the weights it leaves.
    - `criterion`: what lambda (and the order) is chosen by: `"error"` of data left out
      (default), `"gcv"` or `"reml"`, as in `leave_one_out`.
    - `folds`: choose lambda by `cross_validate` with so many folds; default by
      `leave_one_out`, of which one fit a lambda is enough.
    - `distance`: on a `PointCloud`, d_N is the chord (default: fast, right to third order)
      or the length of the shortest curve (`"geodesic"`, a few solves more, for data far
      from the map; `lam` has to be given). Other targets have d_N as it is.

    **Returns:** a `RegressionMap`: call it on new points; `.posterior()` says how sure it
    is, `.summary()` how it fits; `.energies`, `.lam`, `.result`, `.stats`.

    **Raises** ValueError as `make_problem` does and for options that exclude each other,
    RuntimeError where Newton does not converge, or a loss rejects so many data that
    nothing is determined. **Warns** where the noise does not settle.

    Source: F. Steinke, M. Hein, Non-parametric Regression Between Manifolds, NIPS 2008.

    **Example:** a polar wander path; lambda in Myr$^3$, chosen if it is left out.

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    model = mr.fit(mr.Interval(0, 320), mr.Sphere(2), data.ages, data.directions, 1e3)
    model(65.0)  # a unit vector
    ```
    """
    data: dict[str, Any] = {
        "weights": weights,
        "sigma": sigma,
        "precision": precision,
        "frames": frames,
        "loss": loss,
        "centres": centres,
        "degree": degree,
        "width": width,
        "graded": graded,
        "tension": tension,
        "order": order,
    }
    choice = {"distance": distance, "criterion": criterion, "folds": folds}
    options |= {"x_sigma": x_sigma, "x_min": x_min, "x_max": x_max, "x_error": x_error}
    choice |= {"wavelength": wavelength}
    found = chosen_fit(source, target, x, y, lam, data, scatter, **choice, **options)
    return found[0]
