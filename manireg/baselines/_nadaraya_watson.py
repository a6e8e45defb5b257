"""Local averages: the Nadaraya-Watson estimator with values in a manifold."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray, ScalarLike

from .._input.numbers import Numbers
from .._input.precision import check_x64
from .._selection.choice import evaluated
from .._selection.folds import held_out_error, training_sets
from .._selection.lambda_grid import GRID
from .._source import AbstractSource
from .._sources.checks import check_grid, check_positive
from .._sources.data import check_data
from ..manifolds import AbstractManifold
from ._frechet import frechet_mean
from ._inputs import check_choice, predicted

_BANDWIDTH = (
    "must be positive and finite",
    "Leave it out to choose by cross-validation.",
)
BATCH = 64  # means side by side; a batch iterates until its slowest has settled
# means of far too wide kernels may wander; scores need neither their digits nor the
# best of several minima
ROUGH = {"starts": 1, "rtol": 1e-4, "max_steps": 30}


class NadarayaWatson(eqx.Module):
    """Weighted Frechet means of the data, weighted by nearness to the input."""

    source: AbstractSource
    target: AbstractManifold
    x: Float[Array, "k s"]
    y: Float[Array, "k t"]
    weights: Float[Array, " k"]
    bandwidth: Float[Array, ""]
    bandwidths: Float[Array, " grid"]
    """The grid `bandwidth` was chosen from."""
    scores: Float[Array, "folds grid"]
    """(Weighted) mean geodesic error on each held-out fold; no folds if
    `bandwidth` was given."""

    def __call__(self, x: Numbers) -> Float[Array, "..."]:
        """Values at `x`, `(n, *source.point_shape)` or a single point, on the target."""

        def values(flat):
            anywhere = jnp.ones((len(flat), len(self.x)), bool)
            return _means(self, flat, self.bandwidth, anywhere)

        return predicted(self, self.source, self.target, x, values)


def nadaraya_watson(
    source: AbstractSource,
    target: AbstractManifold,
    x: Numbers,
    y: Numbers,
    bandwidth: Numbers | None = None,
    *,
    bandwidths: Numbers | None = None,
    folds: int | None = None,
    key: PRNGKeyArray | None = None,
    weights: Numbers | None = None,
) -> NadarayaWatson:
    r"""$\Psi(x) = \arg\min_q \sum_i w_i e^{-d_M(x, x_i)^2 / 2h^2} d_N(q, y_i)^2$, see
    `frechet_mean`.

    Source: B. Davis, P. Fletcher, E. Bullitt, S. Joshi, Population shape regression
    from random design data, ICCV 2007 ([8] of Steinke and Hein).

    **Arguments:**

    - `source`, `target`, `x`, `y`, `weights`, `folds`, `key`: as for
      `manireg.cross_validate`; `folds=len(x)` leaves out one pair at a time, at the
      same cost.
    - `bandwidth`: h, in the unit of the source; default by cross-validation.
    - `bandwidths`: the grid to choose from. Default 20 values in geometric progression,
      from half the median distance of an input to the nearest other one, to half the
      largest distance; extended (at most twice) where the best one sits on an edge.

    **Example:**

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    model = mr.baselines.nadaraya_watson(
        mr.Interval(0, 320), mr.Sphere(2), data.ages, data.directions, 10.0
    )
    model(65.0)
    ```
    """
    check_x64()
    check_choice(bandwidth, bandwidths, "bandwidth")
    flat, outputs, weights = check_data(source, target, x, y, weights)
    build = lambda bandwidth, grid, scores: NadarayaWatson(
        source, target, flat, outputs, weights, bandwidth, grid, scores
    )
    if bandwidth is not None:
        bandwidth = check_positive("bandwidth", bandwidth, *_BANDWIDTH)
        return build(bandwidth, bandwidth[None], jnp.zeros((0, 1)))
    training = jnp.asarray(training_sets(weights, folds, key))
    if bandwidths is None:
        grid = _bandwidth_grid(source, flat)
    else:
        grid = jnp.asarray(check_grid("bandwidths", bandwidths, *_BANDWIDTH))
    draft = build(grid[0], grid, jnp.zeros((0, len(grid))))
    evaluate = lambda grid: (_scores(draft, training, grid),)
    grid, (scores,), best = evaluated(grid, evaluate, widen=bandwidths is None)
    return build(grid[best], grid, scores)


def _bandwidth_grid(
    source: AbstractSource, x: Float[Array, "k s"]
) -> Float[Array, " grid"]:
    distances = np.sqrt(np.asarray(source.squared_distances(x, x)))
    apart = np.where(distances > 1e-9 * distances.max(), distances, np.inf)
    return jnp.geomspace(
        0.5 * np.median(apart.min(axis=1)), 0.5 * distances.max(), GRID
    )


@eqx.filter_jit
def _means(
    model: NadarayaWatson,
    x: Float[Array, "n s"],
    bandwidth: ScalarLike,
    usable: Bool[Array, "n k"],
    **options,
) -> Float[Array, "n t"]:
    """Means at `x` over the `usable` data."""
    y = model.y.reshape(-1, *model.target.point_shape)

    def one(row):
        x, usable = row
        squared = model.source.squared_distances(x[None], model.x)[0]
        logits = jnp.log(model.weights) - squared / (2 * bandwidth**2)
        # softmax, because far from all data every kernel value underflows
        share = jax.nn.softmax(jnp.where(usable, logits, -jnp.inf))
        return frechet_mean(model.target, y, share, **options).ravel()

    return jax.lax.map(one, (x, usable), batch_size=min(BATCH, len(x)))


@eqx.filter_jit
def _scores(
    model: NadarayaWatson,
    training: Bool[Array, "folds k"],
    bandwidths: Float[Array, " grid"],
) -> Float[Array, "folds grid"]:
    """Each datum is predicted from the data outside its own fold."""
    fold_of = jnp.argmin(training, axis=0)
    usable = fold_of[:, None] != fold_of[None, :]

    def one(bandwidth):
        predicted = _means(model, model.x, bandwidth, usable, **ROUGH)
        score = lambda fold: held_out_error(
            model.target, predicted, model.y, model.weights, fold
        )
        return jax.vmap(score)(training)

    return jax.lax.map(one, bandwidths).T
