"""Energies of any map, by autodiff: to check a fit, and to look at the regulariser."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import roots_gegenbauer

from .._discretisation.domain import Domain, discretise, with_second_forms
from .._input.precision import check_x64
from .._sources.sources import Source
from ..manifolds import AbstractManifold, Sphere
from ..manifolds._defaults.frames import tangent_frames


def eells_energy(
    source: Source,
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
    source: Source, map: Callable[[Array], Array], samples: int | Domain = 4096
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
        return jnp.ravel(map(curve.reshape(source.point_shape)))

    zero = jnp.zeros(frame.shape[1])
    return along(zero), jnp.moveaxis(jax.jacfwd(jax.jacfwd(along))(zero), 0, -1)


def _integrate(density, domain: Domain):
    values = jax.jit(jax.vmap(density))(
        domain.points, domain.frames, domain.second_forms
    )
    return jnp.sum(domain.weights * values)


def _samples(source: Source, samples: int | Domain) -> Domain:
    check_x64(source)
    if isinstance(samples, Domain):
        return samples
    samples = int(samples)
    if samples < 1:
        raise ValueError(f"samples: must be at least 1, found {samples}.")
    if isinstance(source, Sphere) and source.dim > 1:
        return _sphere_gauss(source, samples)
    per_centre = 16 if source.dim == 2 else max(10, 3**source.dim)
    return discretise(source, max(1, samples // per_centre))


def _sphere_gauss(sphere: Sphere, samples: int) -> Domain:
    """Product rule on S^n, exact for polynomials: Gauss-Gegenbauer in the last
    coordinate, S^{n-1} in the others, down to the trapezoid rule on the circle."""
    order = max(4, round((samples / 2) ** (1 / sphere.dim)))
    angle = 2 * np.pi * np.arange(2 * order) / (2 * order)
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    weights = np.full(len(points), np.pi / order)
    for n in range(2, sphere.dim + 1):
        z, w = roots_gegenbauer(order, (n - 1) / 2)
        rho = np.sqrt(1 - z**2)[:, None, None]
        rows = np.broadcast_to(z[:, None, None], (len(z), len(points), 1))
        points = np.concatenate([rho * points, rows], axis=2).reshape(-1, n + 1)
        weights = np.outer(w, weights).ravel()
    radius = np.asarray(sphere.radius)
    frames = tangent_frames(sphere, points)
    return with_second_forms(
        sphere, radius * points, frames, radius**sphere.dim * weights
    )
