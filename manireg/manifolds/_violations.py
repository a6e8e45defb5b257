"""How far a manifold is from obeying each law of `_laws`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from ._base import AbstractManifold


@eqx.filter_jit
def violations(
    manifold: AbstractManifold,
    p: Array,
    key: PRNGKeyArray,
    unit: Array,
    reach: Array,
    injectivity_radius: Array,
    log_up_to: Array,
) -> tuple[Array, ...]:
    """The size of the violation of each law, in their order in `_laws`, at each point p:
    shape (k,). `log_up_to`: share of the injectivity radius."""
    shape, axes = p.shape[1:], tuple(range(-(p.ndim - 1), 0))
    size = int(np.prod(shape))
    project, tangent = manifold.project, manifold.tangent_projection

    def inner(x, y):
        return jnp.sum(x * y, axis=axes)

    def norm(x):
        return jnp.sqrt(inner(x, x))

    def expand(scalars):
        return scalars.reshape(*scalars.shape, *[1] * len(shape))

    def normalised(x):  # what is only rounding counts as 0
        length = norm(x)
        return x * expand(jnp.where(length > 1e-8, 1.0 / length, 0.0))

    def worst(*violations):
        return jnp.max(jnp.stack(violations), axis=0)

    keys = jax.random.split(key, 4)
    a, b, c = (normalised(jax.random.normal(k, p.shape)) for k in keys[:3])
    ta, tb, tc = tangent(p, jnp.stack([a, b, c]))
    u, v, normal = normalised(ta), normalised(tb), normalised(c - tc)

    # the projection and its first two derivatives, at p and off the manifold
    x = p + 0.2 * unit * c
    at = jnp.stack([p, p, x])
    first, second = unit * jnp.stack([u, a, a]), unit * jnp.stack([v, b, b])

    def along_first(at):
        return jax.jvp(project, (at,), (first,))

    (y, dy), (_, ddy) = jax.jvp(along_first, (at,), (second,))
    y, back = y[2], jax.vjp(project, p)[1](a)[0]
    differences = _differences(project, x, first[2], second[2])
    basis = jnp.eye(size).reshape(size, *shape)
    matrix = tangent(p[:, None], basis).reshape(-1, size, size)

    # second fundamental form
    bend = unit * manifold.second_fundamental_form(p, u, v)
    swapped = unit * manifold.second_fundamental_form(p, v, u)
    turn = jax.jvp(lambda p: tangent(p, v), (p,), (unit * u,))[1]

    # one geodesic, at the times 0 and 1, and farther
    w = 0.5 * injectivity_radius * v
    times = expand(jnp.array([0.0, 1.0])[:, None] * jnp.ones(len(p)))

    def velocity(t):
        return jax.jvp(lambda t: manifold.exp(p, t * w), (t,), (jnp.ones_like(t),))

    (ends, speeds), (_, accelerations) = jax.jvp(
        velocity, (times,), (jnp.ones_like(times),)
    )
    q = ends[1]
    farther = 2 * jnp.stack([jnp.asarray(0.9), log_up_to])
    far = manifold.exp(p, expand(farther[:, None] * jnp.ones(len(p))) * w)
    logs = manifold.log(jnp.stack([p, q, p, p, p]), jnp.stack([q, p, p, *far]))

    # squared distances with derivatives in the second argument
    d2 = manifold.squared_distance(
        jnp.stack([p, p, q, p, far[0]]), jnp.stack([p, q, p, far[0], p])
    )
    squares = inner(w, w) * farther[0] ** jnp.array([[0], [2]])

    def gradient(z):
        two = jnp.stack([p, p])
        return jax.grad(lambda z: jnp.sum(manifold.squared_distance(two, z)))(z)

    pair = jnp.stack([p, q])
    grads, hessians = jax.jvp(gradient, (pair,), (jnp.stack([u, jnp.zeros_like(u)]),))

    r = manifold.random_points(keys[3], len(p) + 1)
    off = 0.7 * reach * normal
    fixed = jnp.stack([p, y, q, r[1:], p + off, p - off])
    images = project(fixed)
    moved = norm(images - fixed) / unit
    vectors = [x - y, a, a, bend, *accelerations, grads[0], hessians[0], grads[1]]
    offset, tax, tay, bent, *pushed, slope, hessian, pull = tangent(
        jnp.stack([y, x, y, p, *ends, p, p, q]), jnp.stack(vectors)
    )

    return (
        moved[0],
        moved[1],
        worst(
            jnp.max(jnp.abs(matrix - matrix.swapaxes(1, 2)), axis=(1, 2)),
            jnp.max(jnp.abs(matrix @ matrix - matrix), axis=(1, 2)),
        ),
        jnp.abs(jnp.trace(matrix, axis1=1, axis2=2) - manifold.dim),
        worst(norm(dy[1] / unit - ta), norm(back - ta)),
        norm(offset) / unit,
        worst(norm(differences[0] - dy[2]), norm(differences[1] - ddy[2])) / unit,
        worst(*norm(images[4:] - p)) / unit,
        norm(tax - tay),
        norm(bend - ddy[0] / unit),
        norm(bend - turn),
        worst(norm(bend - swapped), norm(bent)),
        norm(ends[0] - p) / unit,
        moved[2],
        worst(norm(speeds[0] - w), jnp.abs(norm(speeds[1]) - norm(w))) / unit,
        worst(*map(norm, pushed)) / unit,
        worst(
            norm(logs[0] - w),
            norm(logs[2]),
            *norm(logs[3:] - expand(farther[:, None]) * w),
        )
        / unit,
        jnp.abs(d2[0]) / unit**2,
        worst(*jnp.abs(d2[jnp.array([1, 3])] - squares)) / unit**2,
        worst(*jnp.abs(d2[1::2] - d2[2::2])) / unit**2,
        worst(norm(slope) / unit, norm(hessian - 2 * u)),
        norm(pull + 2 * logs[1]) / unit,
        worst(moved[3], jnp.where(norm(r[1:] - r[:1]) > 0, 0.0, jnp.inf)),
    )


def _differences(function, x: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """First derivative along u and second along u, v by differences of order 4."""

    def first(h):
        plus, minus = function(jnp.stack([x + h * u, x - h * u]))
        return (plus - minus) / (2 * h)

    def second(h):
        corners = [x + i * h * u + j * h * v for i in (1, -1) for j in (1, -1)]
        pp, pm, mp, mm = function(jnp.stack(corners))
        return (pp - pm - mp + mm) / (4 * h**2)

    h = 2e-3
    return tuple((4 * d(h) - d(2 * h)) / 3 for d in (first, second))
