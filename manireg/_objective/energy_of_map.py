"""Energies of any map, by autodiff: to check a fit, and to look at the regulariser."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._discretisation.domain import Domain, discretise, with_second_forms
from .._discretisation.polarisation import components, jets_along
from .._input.precision import check_x64
from .._source import AbstractSource
from .._sources.orders import check_known
from ..manifolds import AbstractManifold
from ..manifolds._defaults.covariant_derivative import derivatives_along
from ..manifolds._defaults.frames import tangent_frames
from .covariant_derivatives import along_curve, roots


def energy(
    source: AbstractSource,
    target: AbstractManifold,
    map: Callable[[Array], Array],
    samples: int | Domain = 4096,
    *,
    order: int = 2,
) -> Float[Array, ""]:
    r"""$S_p(\phi) = \int_M |\mathrm{Sym}\, \nabla^{p-1} d\phi|^2$, the squared norm of the
    p-th covariant derivative along geodesics of M: $S_1$ the harmonic energy, $S_2$ the
    Eells energy.

    **Arguments:**

    - `source`, `target`: as for `fit`.
    - `map`: a JAX function from one point of `source` to one point of `target`, defined
      on a neighbourhood of the source (only its values on the source matter).
    - `samples`: about how many quadrature points, or a `Domain` of your own (a disk,
      say). Gauss rules on intervals, boxes and spheres, trapezoid on tori: they reach
      rounding for smooth maps. Quasi-uniform points on other manifolds: 1e-2..1e-3.
    - `order`: p, 1 to 4; any that the geodesics of the source are known to: 4 on curves,
      3 elsewhere, 2 on scans (Ambient(scan) is flat). Maps into scans: at most 3.

    **Raises** ValueError for another `order`, and for `samples` below 1.

    **Example:** a great circle with the angle $t^3$ has $S_3 = \int 6^2 = 36$.

    ```python
    circle = lambda t: jnp.array([jnp.cos(t**3), jnp.sin(t**3), 0.0])
    mr.energy(mr.Interval(0, 1), mr.Sphere(2), circle, order=3)  # 36.00
    ```
    """
    check_known(order, source, target)

    domain = _samples(source, samples, order)
    m = domain.dim

    def density(geodesics):
        along = lambda curve: along_curve(target, _derivatives(source, map, curve))
        values = jax.vmap(along)(_curves(geodesics, m, order))
        return jnp.sum((roots(m, order) * (components(m, order) @ values)) ** 2)

    return _integrate(density, domain, order)


def eells_energy(
    source: AbstractSource,
    target: AbstractManifold,
    map: Callable[[Array], Array],
    samples: int | Domain = 4096,
) -> Float[Array, ""]:
    r"""$S(\phi) = \int_M |P_{\phi(x)} (D^2\phi[E_a, E_b] + D\phi\, II(E_a, E_b))|^2$, the
    squared norm of the second covariant derivative (paper, (2) and (5)): `energy` of
    order 2, with its arguments.

    **Example:** an angle of $t^2$ has $S = \int 2^2 = 4$.

    ```python
    circle = lambda t: jnp.array([jnp.cos(t**2), jnp.sin(t**2), 0.0])
    mr.eells_energy(mr.Interval(0, 1), mr.Sphere(2), circle)  # 4.000
    ```
    """
    return energy(source, target, map, samples)


def thin_plate_energy(
    source: AbstractSource, map: Callable[[Array], Array], samples: int | Domain = 4096
) -> Float[Array, ""]:
    r"""$\int_M |D^2\phi[E_a, E_b] + D\phi\, II(E_a, E_b)|^2$, without the projection to
    the target (paper, (3)): `eells_energy` plus the bending of the target in its ambient
    space. Arguments as for `energy`.

    **Example:** of the same circle $S = \int (2^2 + (2t)^4) = 4 + 16/5$: space sees
    that circles bend.

    ```python
    circle = lambda t: jnp.array([jnp.cos(t**2), jnp.sin(t**2), 0.0])
    mr.thin_plate_energy(mr.Interval(0, 1), circle)  # 7.200
    ```
    """
    domain = _samples(source, samples, 2)
    m = domain.dim

    def density(geodesics):
        along = lambda curve: _derivatives(source, map, curve)[2]
        values = jax.vmap(along)(_curves(geodesics, m, 2))
        return jnp.sum((roots(m, 2) * (components(m, 2) @ values)) ** 2)

    return _integrate(density, domain, 2)


def _curves(geodesics: Float[Array, "J s"], m: int, order: int):
    """Derivatives of geodesics through a point, in all `directions`."""
    matrices = jets_along(m, order)
    ends = np.cumsum([matrix.shape[1] for matrix in matrices])
    rows = jnp.split(geodesics, ends[:-1])
    return jnp.stack([matrix @ own for matrix, own in zip(matrices, rows)], axis=1)


def _derivatives(source, map, curve: Float[Array, "p s"]) -> list[Float[Array, " t"]]:
    """Of the map along a curve with these derivatives."""
    value = lambda x: _value(source, map, x)
    return [*derivatives_along(value, len(curve) - 1)(*curve)]


def _value(source, map, x: Float[Array, " s"]) -> Float[Array, " t"]:
    return jnp.ravel(map(source.from_ambient(x[None])[0]))


def _integrate(density, domain: Domain, order: int):
    values = jax.jit(jax.vmap(density))(domain.geodesics(order))
    return jnp.sum(domain.weights * values)


def _samples(source, samples: int | Domain, order: int) -> Domain:
    check_x64(source)
    if isinstance(samples, Domain):
        return samples
    samples = int(samples)
    if samples < 1:
        raise ValueError(f"samples: must be at least 1, found {samples}.")
    exact = source.exact_rule(samples)
    if exact is not None:
        points, weights = exact
        frames = tangent_frames(source, points)
        return with_second_forms(source, points, frames, weights, order)
    per_centre = 16 if source.dim == 2 else max(10, 3**source.dim)
    return discretise(source, max(1, samples // per_centre), order=order)
