"""Data and discretisation of one regression, analysed once on the host."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree, ScalarLike

from .._algebra.sparse import SparsityPattern, band_order, sparsity
from .._discretisation.domain import Domain
from .._discretisation.jets import (
    Jets,
    bucket_centres,
    in_order,
    jet_values,
    jets_of,
    value_jets,
)
from .._discretisation.local_polynomials import LocalPolynomials, local_polynomials
from .._discretisation.sampling import sample
from .._input.numbers import Numbers
from .._input.precision import as_scalar, check_x64
from .._source import AbstractSource
from .._sources.checks import check_data, check_order, check_tension
from .._sources.noise import Noise, check_noise
from ..manifolds import AbstractManifold
from .energies import (
    AbstractEnergy,
    AmbientEnergy,
    IntrinsicEnergy,
    Tension,
    affine_derivative,
)
from .losses import AbstractMisfit
from .noise import Precision, equal_precisions, misfit_of, precision_of
from .robust import AbstractLoss, Squared, check_loss
from .terms import AbstractTerm


class Problem(eqx.Module):
    """Built by `make_problem`, solved by `solve` for any lambda.

    `y` and `weights` are leaves: replace them (`eqx.tree_at`) to solve for other outputs
    or other folds with the same compiled program.
    """

    source: AbstractSource
    target: AbstractManifold
    basis: LocalPolynomials
    energy_jets: Jets
    """Value and intrinsic derivatives at the quadrature points."""
    free_jets: Jets | None
    """The same with ambient derivatives, for the free start: affine maps of the ambient
    space then cost nothing. None on a flat source, where they are the same."""
    energy_weights: Float[Array, "e p"]
    data_jets: Jets
    """Values at the data."""
    x: Float[Array, "k s"]
    y: Float[Array, "k t"]
    weights: Float[Array, " k"]
    precision: Precision
    misfit: AbstractMisfit
    """The data term."""
    noise: Noise | None
    """What is known of it, for inference."""
    owner: Int[np.ndarray, " k"] | None
    """Where an x is known within errors only, and rows are values that it may have: of
    which datum each is one; None: rows are data."""
    origin: Float[Array, " t"]
    """Psi = origin + A w: data far from zero cost no digits."""
    pattern: SparsityPattern
    energy_places: tuple[Int[Array, "_ _"], ...]
    """For each bucket of elements, where its pairs of centres are in the pattern."""
    data_places: tuple[Int[Array, "_ _"], ...]
    energy: AbstractEnergy
    energy_arguments: PyTree[Float[Array, "Q ..."]]
    terms: tuple[tuple[AbstractTerm, PyTree[Array]], ...]
    """Others, with what they read at each point."""
    data_volume: Float[Array, ""]
    """Of the part of the source that the data fill: less than `volume` where they
    cluster."""
    dim: int = eqx.field(static=True)
    """m, of what is integrated over."""

    @property
    def volume(self) -> Float[Array, ""]:
        return jnp.sum(self.energy_weights)


def data_weights(problem: Problem) -> Float[Array, "e p"]:
    """weight_i / sum_j weight_j, arranged in the elements of the data jets."""
    share = problem.weights / jnp.sum(problem.weights)
    return share[problem.data_jets.index] * problem.data_jets.mask


def number_of_data(problem: Problem) -> int:
    """Independent ones, of positive weight."""
    heavy = np.asarray(problem.weights) > 0
    if problem.owner is None:
        return int(np.sum(heavy))
    return len(np.unique(problem.owner[heavy]))


def psi_jets(problem: Problem, jets: Jets, w: Float[Array, "KC t"]):
    """Jets of Psi = origin + A w, `(e, p, J, t)`."""
    return jet_values(jets, w).at[:, :, 0].add(problem.origin)


def psi_at_data(problem: Problem, w: Float[Array, "KC t"]) -> Float[Array, "k t"]:
    """In the order of the data."""
    values = psi_jets(problem, problem.data_jets, w)[:, :, 0]
    return in_order(problem.data_jets, values, len(problem.y))


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


def with_nodes(
    problem: Problem,
    x: Float[np.ndarray, "nodes s"],
    owner: Int[np.ndarray, " nodes"],
    weights: Float[np.ndarray, " nodes"],
) -> Problem:
    """The same problem, basis and energy with data at several places each: `owner` is of
    which datum each place is one."""
    data_jets = value_jets(problem.basis, x, problem.energy_jets)
    pattern, energy_places, data_places = pattern_of(
        problem.basis, problem.energy_jets, data_jets
    )
    of_owner = lambda tree: jax.device_put(
        jax.tree.map(lambda a: np.asarray(a)[owner], tree)
    )
    terms = tuple(
        (term, of_owner(args) if term.place == "data" else args)
        for term, args in problem.terms
    )
    relative = of_owner(problem.precision.relative)
    precision = eqx.tree_at(lambda p: p.relative, problem.precision, relative)
    noise = None if problem.noise is None else of_owner(problem.noise)
    changes = {
        "x": jax.device_put(x),
        "y": of_owner(problem.y),
        "weights": jax.device_put(weights),
        "owner": owner,
        "precision": precision,
        "noise": noise,
        "terms": terms,
        "data_jets": data_jets,
        "pattern": pattern,
        "energy_places": energy_places,
        "data_places": data_places,
    }
    return dataclasses.replace(problem, **changes)


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


def assemble_problem(
    source,
    target,
    basis,
    domain: Domain,
    x,
    y,
    weights,
    energy: AbstractEnergy | None = None,
    terms: Sequence[AbstractTerm] = (),
    data_volume: ScalarLike | None = None,
    noise: Noise | None = None,
    loss: AbstractLoss = Squared(),
) -> Problem:
    """The same from a basis and a quadrature of your own; inputs are not checked."""
    if data_volume is None:
        data_volume = np.sum(np.asarray(domain.weights))
    energy = IntrinsicEnergy() if energy is None else energy
    if noise is None:
        relative = equal_precisions(len(y))
    else:
        relative = precision_of(noise, np.asarray(weights) > 0)
    order = max(0, *energy.orders, *(o for term in terms for o in term.orders))
    geodesics = domain.geodesics(order)
    energy_jets = jets_of(basis, geodesics, order)
    free_jets = None
    if np.any(straight := geodesics[:, 1 + domain.dim :]):
        straight[:] = 0
        free_jets = jets_of(basis, geodesics, order)
    data_jets = value_jets(basis, x, energy_jets)
    pattern, energy_places, data_places = pattern_of(basis, energy_jets, data_jets)
    at_points = np.asarray(domain.weights)[np.asarray(energy_jets.index)]
    share = np.asarray(weights) / np.sum(np.asarray(weights))
    places = {"quadrature": (domain.points, None), "data": (x, y)}
    return Problem(
        source=source,
        target=target,
        basis=basis,
        energy_jets=energy_jets,
        free_jets=free_jets,
        energy_weights=jax.device_put(at_points * np.asarray(energy_jets.mask)),
        data_jets=data_jets,
        x=x,
        y=y,
        weights=weights,
        precision=relative,
        misfit=misfit_of(relative, loss),
        noise=noise,
        owner=None,
        origin=jax.device_put(share @ np.asarray(y)),
        pattern=pattern,
        energy_places=energy_places,
        data_places=data_places,
        energy=energy,
        energy_arguments=_arrays(energy.arguments(domain.points, None)),
        terms=tuple((t, _arrays(t.arguments(*places[t.place]))) for t in terms),
        data_volume=as_scalar(data_volume),
        dim=source.sampled.dim,
    )


def _arrays(arguments: PyTree) -> PyTree:
    """Copies: JAX may share the memory of NumPy arrays, which may change."""
    return jax.device_put(jax.tree.map(np.array, arguments))


def pattern_of(basis: LocalPolynomials, energy_jets: Jets, data_jets: Jets):
    """Pattern of the Hessian, and the places in it of the energy's and the data's
    elements."""
    energy, data = (bucket_centres(j, basis.size) for j in (energy_jets, data_jets))
    supports = np.asarray(basis.centres), np.asarray(basis.widths)
    pattern, places = sparsity(
        [*energy, *data], *supports, basis.size, on_curve=basis.dim == 1
    )
    return pattern, places[: len(energy)], places[len(energy) :]
