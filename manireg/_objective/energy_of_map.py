"""Energies of any map, by autodiff: to check a fit, and to look at the regulariser."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._discretisation.domain import Domain, discretise, with_second_forms
from .._input.precision import check_x64
from .._source import AbstractSource
from ..manifolds import AbstractManifold
from ..manifolds._defaults.frames import tangent_frames


def eells_energy(
    source: AbstractSource,
    target: AbstractManifold,
    map: Callable[[Array], Array],
    samples: int | Domain = 4096,
) -> Float[Array, ""]:
    r"""$S(\phi) = \int_M |P_{\phi(x)} (D^2\phi[E_a, E_b] + D\phi\, II(E_a, E_b))|^2$, the
    squared norm of the second covariant derivative (paper, (2) and (5)).

    **Arguments:**

    - `source`, `target`: as for `fit`.
    - `map`: a JAX function from one point of `source` to one point of `target`, defined
      on a neighbourhood of the source (only its values on the source matter).
    - `samples`: about how many quadrature points, or a `Domain` of your own (a disk,
      say). Gauss rules on intervals, boxes and spheres, trapezoid on tori: they reach
      rounding for smooth maps. Quasi-uniform points on other manifolds: 1e-2..1e-3.
    """
    domain = _samples(source, samples)

    def density(x, frame, form):
        value, second = _second_derivative(source, map, x, frame, form)
        p = value.reshape(target.point_shape)
        project = lambda v: target.tangent_projection(p, v.reshape(p.shape)).ravel()
        return jnp.sum(jax.vmap(jax.vmap(project))(second) ** 2)

    return _integrate(density, domain)


def thin_plate_energy(
    source: AbstractSource, map: Callable[[Array], Array], samples: int | Domain = 4096
) -> Float[Array, ""]:
    r"""$\int_M |D^2\phi[E_a, E_b] + D\phi\, II(E_a, E_b)|^2$, without the projection to
    the target (paper, (3)): `eells_energy` plus the bending of the target in its ambient
    space. Arguments as for `eells_energy`."""

    def density(x, frame, form):
        return jnp.sum(_second_derivative(source, map, x, frame, form)[1] ** 2)

    return _integrate(density, _samples(source, samples))


def _second_derivative(source, map, x, frame, form):
    """Value (t,) and intrinsic second derivative (m, m, t) of `map` at x."""

    def along(u):
        curve = x + frame @ u + 0.5 * jnp.einsum("a,b,abs->s", u, u, form)
        return jnp.ravel(map(source.from_ambient(curve[None])[0]))

    zero = jnp.zeros(frame.shape[1])
    return along(zero), jnp.moveaxis(jax.jacfwd(jax.jacfwd(along))(zero), 0, -1)


def _integrate(density, domain: Domain):
    values = jax.jit(jax.vmap(density))(
        domain.points, domain.frames, domain.second_forms
    )
    return jnp.sum(domain.weights * values)


def _samples(source, samples: int | Domain) -> Domain:
    check_x64(source)
    if isinstance(samples, Domain):
        return samples
    samples = int(samples)
    if samples < 1:
        raise ValueError(f"samples: must be at least 1, found {samples}.")
    exact = source.exact_rule(samples)
    if exact is not None:
        points, weights = exact
        return with_second_forms(
            source, points, tangent_frames(source, points), weights
        )
    per_centre = 16 if source.dim == 2 else max(10, 3**source.dim)
    return discretise(source, max(1, samples // per_centre))
