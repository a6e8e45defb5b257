"""The paper's first experiment: a curve on the sphere with von Mises-Fisher noise."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, PRNGKeyArray

from .._input.precision import check_x64


class LineOnSphere(eqx.Module):
    r"""Noisy samples `y` (k, 3) of the curve `truth` at inputs `x` (k,) in [0, 1]."""

    x: Float[Array, " k"]
    y: Float[Array, "k 3"]
    convention: str = eqx.field(static=True)

    def truth(self, t: ArrayLike) -> Float[Array, "... 3"]:
        r"""The curve $\phi(t) = 40 t^2$, $\theta(t) = 1.3 \pi t + \pi \sin(\pi t)$ in
        radians, at inputs `t` (...)."""
        t = jnp.asarray(t, self.x.dtype)
        phi = 40 * t**2
        theta = 1.3 * jnp.pi * t + jnp.pi * jnp.sin(jnp.pi * t)
        if self.convention == "polar":
            latitude, longitude = jnp.pi / 2 - theta, phi
        else:
            latitude, longitude = phi, theta
        x = jnp.cos(latitude) * jnp.cos(longitude)
        y = jnp.cos(latitude) * jnp.sin(longitude)
        return jnp.stack([x, y, jnp.sin(latitude)], axis=-1)


def line_on_sphere(
    key: PRNGKeyArray,
    k: int,
    kappa: ArrayLike,
    convention: str = "polar",
    *,
    sort: bool = False,
) -> LineOnSphere:
    r"""`k` inputs uniform on [0, 1] and the curve of `LineOnSphere.truth` there, with
    von Mises-Fisher noise of concentration `kappa` (about $1/\sqrt\kappa$ radians in
    each of two directions).

    The paper names the angles but not their roles. `convention="polar"`: theta is the
    polar angle, phi the azimuth (length 36.7, Eells energy 1.04e6); `"azimuth"`: theta
    is the azimuth, phi the elevation, as in MATLAB's `sph2cart` (41.6 and 1.1e5).
    `sort=True` sorts the inputs.

    **Example:**

    ```python
    data = mr.datasets.line_on_sphere(jax.random.key(0), k=70, kappa=1000)
    data.x, data.y  # (70,), (70, 3)
    ```
    """
    check_x64()
    if convention not in ("polar", "azimuth"):
        raise ValueError(f"`convention` is 'polar' or 'azimuth', found {convention!r}.")
    if k < 1:
        raise ValueError(f"`k` must be at least 1, found {k}.")
    key_x, key_y = jax.random.split(key)
    x = jax.random.uniform(key_x, (k,))
    x = jnp.sort(x) if sort else x
    clean = LineOnSphere(x, jnp.zeros((k, 3), x.dtype), convention).truth(x)
    return LineOnSphere(x, von_mises_fisher(key_y, clean, kappa), convention)


def von_mises_fisher(
    key: PRNGKeyArray, mean: Float[Array, "*batch 3"], kappa: ArrayLike
) -> Float[Array, "*batch 3"]:
    r"""One draw about each unit vector `mean` from the von Mises-Fisher distribution on
    $S^2$, density $\propto \exp(\kappa \langle \mu, y \rangle)$; `kappa` >= 0
    broadcasts against the batch shape.

    Exact, by inversion: $s = 1 - \langle\mu, y\rangle$ has the distribution function
    $(1 - e^{-\kappa s}) / (1 - e^{-2\kappa})$, so
    $s = -\log(1 - u (1 - e^{-2\kappa})) / \kappa$ with u uniform; the azimuth about the
    mean is uniform. Working with s keeps full relative accuracy at any concentration.
    """
    check_x64()
    key_s, key_azimuth = jax.random.split(key)
    u = jax.random.uniform(key_s, mean.shape[:-1], mean.dtype)
    azimuth = 2 * jnp.pi * jax.random.uniform(key_azimuth, u.shape, mean.dtype)
    kappa = jnp.asarray(kappa, mean.dtype)
    some = jnp.where(kappa > 0, kappa, 1.0)
    s = jnp.where(kappa > 0, -jnp.log1p(u * jnp.expm1(-2 * some)) / some, 2 * u)
    e1, e2 = _frame(mean)
    around = jnp.cos(azimuth)[..., None] * e1 + jnp.sin(azimuth)[..., None] * e2
    y = (1 - s)[..., None] * mean + jnp.sqrt(s * (2 - s))[..., None] * around
    return y / jnp.linalg.norm(y, axis=-1, keepdims=True)


def _frame(p: Float[Array, "*batch 3"]) -> tuple[Array, Array]:
    """Two unit vectors that make an orthonormal basis with the unit vector p, without
    branches or cancellation (Duff et al. 2017, JCGT 6(1))."""
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    sign = jnp.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    e1 = jnp.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    e2 = jnp.stack([b, sign + y * y * a, -y], axis=-1)
    return e1, e2
