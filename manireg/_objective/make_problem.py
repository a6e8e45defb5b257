"""From what users give to a problem: checks and defaults, once, on the host."""

from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np

from .._algebra.sparse import band_order
from .._discretisation.local_polynomials import local_polynomials
from .._discretisation.sampling import sample
from .._input.numbers import Numbers
from .._input.precision import as_scalar, check_x64
from .._source import AbstractSource
from .._sources.data import check_data
from .._sources.noise import check_noise
from .._sources.orders import check_order, check_tension
from ..manifolds import AbstractManifold
from .assemble import assemble_problem
from .energies import (
    AbstractEnergy,
    AmbientEnergy,
    IntrinsicEnergy,
    Tension,
    affine_derivative,
)
from .problem import Problem
from .robust import AbstractLoss, check_loss
from .terms import AbstractTerm


def make_problem(
    source: AbstractSource,
    target: AbstractManifold,
    x: Numbers,
    y: Numbers,
    *,
    weights: Numbers | None = None,
    sigma: Numbers | None = None,
    precision: Numbers | None = None,
    frames: Numbers | None = None,
    loss: AbstractLoss | str = "squared",
    centres: int | None = None,
    degree: int | None = None,
    width: float | None = None,
    graded: bool = False,
    tension: float = 0.0,
    order: int = 2,
    energy: AbstractEnergy | None = None,
    terms: Sequence[AbstractTerm] = (),
) -> Problem:
    r"""Discretise the regression of y on x.

    **Arguments:**

    - `source`: `Interval`, `Box` or a manifold, of dimension m < 2 `order`: derivatives of
      lower order do not control values. Unbounded manifolds are cut to the bounding box
      of `x`.
    - `target`: a manifold.
    - `x`: inputs `(k, *source.point_shape)`, in any order: arrays, lists, series or frames
      of numbers, dates where points are plain numbers (see `Interval`), scipy's `Rotation`
      for 3 x 3 rotations. Equal inputs are repeated measurements; for a pair given twice
      its weights add.
    - `y`: outputs `(k, *target.point_shape)`, on the target to 1e-6 of its reach (a cloud:
      half a spacing), factor by factor in products.
    - `weights`: `(k,)` of the squared errors, at least 0; default 1. Only ratios matter:
      the loss is a weighted mean. Data of weight 0 are not fitted and not scored.
    - `sigma`: the standard deviation of each datum per tangent direction, `(k,)` or one
      number, in the unit of the target (radians on the sphere; see `from_a95`,
      `from_kappa`). Data are weighed by their precisions relative to the mean one, so
      lambda keeps its meaning; the absolute scale is used by posteriors, likelihoods and
      robust losses.
    - `precision`: inverse covariances in its place, where noise depends on the direction:
      `(k, t, t)` in flattened ambient coordinates, whose part in $T_{y_i}N$ counts, or
      `(k, n, n)` in the coordinates of `frames`. The residual is $\log_{y_i} \Phi(x_i)$.
      Zero along a direction: data that slide there.
    - `frames`: orthonormal tangent vectors at each datum as columns, `(k, t, n)`.
    - `loss`: what a residual costs: `"squared"`, or `Huber()`, `Tukey()`, `StudentT()`,
      which let go of outliers. They count in standard deviations: without `sigma` or
      `precision` only `fit` can use them, which finds their scale.
    - `centres`: about how many local polynomials; default about k on curves, 0.4 k on
      surfaces, 0.8 k in dimension 3 (in sizes that share programs), within 32..96, 48..384
      and 64..144 (on products about as many). More resolve finer detail; the cost grows
      with them. They are spread evenly, unless the data cluster: if at least a twentieth
      of them (and 4 to 9) lie five times as densely as on average over the source, and
      more densely than the centres. Then centres and quadrature follow the data: spacing
      is that of the data nearby (a ball around a datum that holds eight others has eight
      times the volume h^m), growing by 0.3 to 0.45 per distance away from them; by
      default as many as that takes, up to 384 (192 in dimension 3), and with fewer all
      are farther apart by the same factor. Lambda means the same. Not on point clouds
      (see `graded`) and on products with a factor other than flat spaces, spheres, tori
      and cylinders: there a `ResolutionWarning` in `solve` tells where more are needed.
    - `degree`: of the local polynomials, at least `order` - 1; default 2, in dimension 3
      and on `Ambient` sources 1 (linear in all directions); for orders 3 and 4 the
      `order`, in fewer centres, so that unknowns are as many.
    - `width`: support radius of a local polynomial in units of the spacing
      $(\mathrm{vol}(M)/K)^{1/m}$, on point clouds and where the centres follow the data
      of their local spacing; default 2.5 on curves, 2.2 on surfaces, 1.5 in dimension 3
      (at 2.2 there a centre meets hundreds) and on `Ambient` sources.
    - `graded`: for point clouds: let resolution and smoothness follow the data. The
      centres' spacing h grows like 1 + d/D with the distance d to the nearest input (D:
      the mean of that distance among the inputs), and lambda in proportion to
      $h^{4-m}$, so that bending within one spacing costs the same everywhere; its
      mean stays `lam`. Energies are then integrals with that weight.
    - `tension`: for `Ambient` sources: $\tau$ of the energy density
      $|P D^2\Psi|^2 + \tau |P (D\Psi - A)|^2 / h^2$ with A the derivative of the affine
      map that fits the data best and $h = D + d$ the spacing of the data (as above): a
      spline in tension (Schweikert 1966; Franke 1985 in several dimensions), which does
      not overshoot between data as one without does. At 1, stretching and bending over
      one spacing cost the same. Default 0, the Eells energy alone. A and h stay those of
      these data if `y` or `weights` are replaced.
    - `order`: p of the energy, the integral of the squared p-th covariant derivative
      (symmetrised): 1 harmonic, 2 (default) the Eells energy, 3 and 4 smoother ones. In
      flat spaces these are the polyharmonic splines: the cubic one for 2, the quintic one
      for 3. Maps of no energy are more for a larger order on intervals and boxes
      (polynomials of degree p - 1), on closed sources they are not. Lambda has the unit
      of length^{2p - m}. 4 on curves only; on point clouds 1 and 2, which as targets
      allow 3, too.
    - `energy`: what smooths; default that of the map into N, on `Ambient` sources that of
      the map of the neighbourhood, with `tension` as above.
    - `terms`: what else is to be minimised, see `AbstractTerm`.

    **Raises** ValueError for float32 mode, wrong shapes, NaN, masked or missing entries,
    points off the source or the target (reflections among rotations are named), too few
    distinct inputs of positive weight (on flat sources C(p - 1 + m, m), else m + 2), noise
    that is not as above (zero or negative, not symmetric, frames off the tangent space),
    an `order` that the source or the target does not allow, tension that is negative, on a
    source that is not `Ambient` or of another order than 2.

    **Example:** the host does its part once, `solve` the rest for any lambda.

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    interval, sphere = mr.Interval(0, 320), mr.Sphere(2)
    problem = mr.make_problem(interval, sphere, data.ages, data.directions)
    mr.solve(problem, 1e3).energies.loss
    ```
    """
    check_x64(source)
    check_x64(target)
    order = order if energy is None else energy.order
    check_order(order, source, target)
    check_tension(tension, source, order)
    x, y, weights = check_data(source, target, x, y, weights, order)
    noise = check_noise(target, np.asarray(y), sigma, precision, frames)
    loss = check_loss(loss).in_dimension(target.dim)
    m = source.sampled.dim
    if energy is None:
        energy = _default_energy(source, tension, order, x, y, weights)
    if not (energy.on_target or target.isometric):
        raise ValueError(
            f"energy: {type(energy).__name__} measures in the ambient space of the "
            f"target, whose metric {type(target).__name__} does not have. Take the "
            "source itself in place of `Ambient`, and leave out `energy` and `tension`."
        )
    _check_terms(energy, terms)
    default = energy.resolution(m)
    degree = default.degree if degree is None else degree
    if degree < max(1, order - 1):
        raise ValueError(
            f"degree: must be at least {max(1, order - 1)}, found {degree}: affine maps, "
            "and polynomials of a lower degree than `order`, have to cost nothing."
        )
    width = default.width if width is None else width
    nodes, spacing, domain, data_volume = sample(
        source, x, centres, graded, order, default.share
    )
    basis = local_polynomials(nodes, width * spacing, degree, domain)
    if m == 1:
        along = band_order(np.asarray(basis.centres), np.asarray(basis.widths))
        basis = jax.tree.map(lambda a: jax.device_put(np.asarray(a)[along]), basis)
    return assemble_problem(
        source,
        target,
        basis,
        domain,
        x,
        y,
        weights,
        energy,
        terms,
        data_volume,
        noise,
        loss,
    )


def with_tension(problem: Problem, tension: float) -> Problem:
    """The same problem, made with tension, with another: all else is shared."""
    check_tension(tension, problem.source, problem.energy.order)
    assert isinstance(problem.energy, Tension)
    energy, arguments = AmbientEnergy(), ()
    if tension > 0:
        energy = eqx.tree_at(lambda e: e.tau, problem.energy, as_scalar(tension))
        arguments = problem.energy_arguments
    where = lambda p: (p.energy, p.energy_arguments)
    return eqx.tree_at(where, problem, (energy, arguments))


def _default_energy(
    source: AbstractSource, tension: float, order: int, x, y, weights
) -> AbstractEnergy:
    if source.sampled is source:
        return IntrinsicEnergy(order)
    if tension == 0:
        return AmbientEnergy(order)
    return Tension(tension, affine_derivative(x, y, weights), x)


def _check_terms(energy: AbstractEnergy, terms: Sequence[AbstractTerm]) -> None:
    names = ["loss", "off_manifold", energy.name, *(term.name for term in terms)]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(f"terms: two have the name {twice[0]!r}; give each its own.")
    for term in terms:
        jets = tuple(range(1 + max(energy.order, 2)))
        known = {"quadrature": jets, "data": (0,)}.get(term.place)
        if known is None:
            raise ValueError(
                f"terms: {term.name} has the place {term.place!r}; expected 'quadrature' "
                "or 'data'."
            )
        if not set(term.orders) <= set(known):
            raise ValueError(
                f"terms: {term.name} reads derivatives of the orders {term.orders}; at "
                f"the {term.place} there are {known}."
            )
