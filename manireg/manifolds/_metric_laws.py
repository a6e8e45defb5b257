"""The laws of a manifold with a metric of its own, and how far one is from obeying
each."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, PRNGKeyArray

from ._base import AbstractManifold
from ._law import Law

# From causes to consequences: the first one broken is the one to look at.
METRIC_LAWS = (
    Law(
        "project(p) = p and project(project(x)) = project(x)",
        "project",
        "It must be a retraction to the manifold.",
    ),
    Law(
        "tangent_projection is idempotent and has rank dim",
        "tangent_projection",
        "P = P^2, and its trace is `dim`: check scale factors and lost directions.",
    ),
    Law(
        "D project(x)[w] is tangent, and w for tangent w",
        "tangent_projection",
        "Either it projects on another space than the tangent space of what `project` "
        "retracts to, or the derivative of `project` is wrong.",
    ),
    Law(
        "from_orthonormal(p, orthonormal(p, v)) = v, and orthonormal is linear",
        "from_orthonormal",
        "They must be inverse to each other on tangent vectors.",
    ),
    Law(
        "exp(p, 0) = p, project(exp(p, v)) = exp(p, v)",
        "exp",
        "Check v = 0, and that end points lie on the manifold.",
    ),
    Law(
        "exp(p, t v) starts with velocity v and keeps its speed in the metric",
        "exp",
        "The geodesic must reach its end at time 1 with speed |v|.",
    ),
    Law(
        "|v|^2 changes along curves by 2 <v, Dv>",
        "covariant_derivative",
        "The connection is not that of the metric: check it against `orthonormal`.",
    ),
    Law(
        "covariant derivatives of the second and third order of geodesics vanish",
        "covariant_derivative",
        "`exp` is no geodesic of that connection, or the other way round.",
    ),
    Law(
        "second_fundamental_form(v, v) is the acceleration of exp(p, t v), symmetric",
        "second_fundamental_form",
        "It is the ambient second derivative of geodesics, polarised.",
    ),
    Law(
        "log(p, exp(p, v)) = v and log(p, p) = 0",
        "log",
        "Tested up to `log_up_to` of the injectivity radius.",
    ),
    Law(
        "squared_distance(p, exp(p, v)) = |v|^2, symmetric, 0 at p",
        "squared_distance",
        "It must be the square of the length of the shortest geodesic.",
    ),
    Law(
        "squared_distance has gradient 0 and Hessian 2 <., .> at coincidence",
        "squared_distance",
        "Not finite: a root at 0; wrong: not the metric of `orthonormal`.",
    ),
    Law(
        "the gradient of squared_distance(p, .) at q is -2 log(q, p)",
        "squared_distance",
        "Its derivative is wrong away from coincidence.",
    ),
    Law(
        "residual(y, .) is 0 at y, where its derivative is `orthonormal`",
        "residual",
        "It must be log_y to first order, in coordinates orthonormal at y.",
    ),
    Law(
        "random_points lie on the manifold and differ",
        "random_points",
        "Retract them; draw a new sample for a new key.",
    ),
)


@eqx.filter_jit
def metric_violations(
    manifold: AbstractManifold,
    p: Array,
    key: PRNGKeyArray,
    unit: Array,
    reach: Array,
    injectivity_radius: Array,
    log_up_to: Array,
) -> tuple[Array, ...]:
    """The size of the violation of each law, in their order, at each point p: `(k,)`.
    Lengths, those of tangent vectors in the metric, are in units of `unit`."""
    keys = jax.random.split(key, len(p) + 1)
    drawn = manifold.random_points(keys[0], len(p) + 1)
    size = lambda v: jnp.sqrt(jnp.sum(v**2))
    on = jax.vmap(lambda r: size(manifold.project(r) - r))(drawn[1:]) / unit
    apart = jax.vmap(lambda r: size(r - drawn[0]) > 0)(drawn[1:])
    at_point = lambda p, key: _at_point(
        manifold, p, key, unit, injectivity_radius, log_up_to
    )
    found = jax.vmap(at_point)(p, keys[1:])
    return *found, jnp.where(apart, on, jnp.inf)


def _at_point(manifold, p, key, unit, radius, log_up_to):
    N, shape = manifold, p.shape
    norm = lambda v: jnp.sqrt(jnp.sum(v**2)) / unit
    worst = lambda *v: jnp.max(jnp.stack(v))
    push = lambda f, x, v: jax.jvp(f, (x,), (v,))[1]
    a, b, c = jax.random.normal(key, (3, *shape))

    def unit_vector(v):
        v = N.tangent_projection(p, v)
        return unit * v / jnp.sqrt(jnp.sum(N.orthonormal(p, v) ** 2))

    inner = lambda at, u, v: jnp.sum(N.orthonormal(at, u) * N.orthonormal(at, v))
    u, v = unit_vector(a), unit_vector(b)
    x = p + 0.2 * unit * c
    y = N.project(x)
    du = push(N.project, x, c)
    basis = jnp.eye(p.size).reshape(p.size, *shape)
    rows = jax.vmap(lambda e: N.tangent_projection(p, e))(basis)
    P = rows.reshape(p.size, p.size).T

    back = N.from_orthonormal(p, N.orthonormal(p, u))
    linear = N.orthonormal(p, u + 2 * v) - N.orthonormal(p, u) - 2 * N.orthonormal(p, v)

    w = 0.5 * radius / unit * u
    curve = lambda t: N.exp(p, t * w)
    derivatives = [curve]
    for _ in range(3):
        f = derivatives[-1]
        derivatives.append(lambda t, f=f: push(f, t, jnp.ones(())))
    start, end = ([f(t) for f in derivatives] for t in (jnp.zeros(()), jnp.ones(())))
    speed2 = [inner(jet[0], jet[1], jet[1]) for jet in (start, end)]
    wanted = inner(p, w, w)
    straight = [N.covariant_derivative(jet[:n]) for jet in (start, end) for n in (3, 4)]

    bent = lambda t: [p + t * u + t**2 * v, u + 2 * t * v, 2 * v]
    speed_along = lambda t: jnp.sum(N.covariant_derivative(bent(t)[:2]) ** 2)
    here = bent(jnp.zeros(()))
    work = jnp.sum(N.covariant_derivative(here[:2]) * N.covariant_derivative(here))
    change = push(speed_along, jnp.zeros(()), jnp.ones(()))

    form = N.second_fundamental_form
    q = end[0]
    shares = 2 * jnp.stack([jnp.asarray(0.9), log_up_to])
    far = [N.exp(p, share * w) for share in shares]
    logs = [N.log(p, q) - w, N.log(p, p)]
    logs += [N.log(p, end) - share * w for end, share in zip(far, shares)]
    lengths = [N.orthonormal(p, v) for v in logs]

    d2 = N.squared_distance
    distances = [d2(p, p), d2(p, q) - wanted, d2(q, p) - wanted]
    distances.append(d2(p, far[0]) - shares[0] ** 2 * wanted)
    at_p, at_q = (jax.grad(lambda z: d2(p, z)) for _ in range(2))
    moved = lambda t: N.project(p + t * u)  # second derivatives along N
    along = lambda t: d2(p, moved(t))
    first, second = jax.grad(along), jax.grad(jax.grad(along))
    zero = jnp.zeros(())
    pulled = N.tangent_projection(q, b)
    pull = jnp.sum(at_q(q) * pulled) + 2 * inner(q, N.log(q, p), pulled)

    missed = push(lambda z: N.residual(p, N.project(z)), p, u)
    scale = unit**2
    return (
        worst(norm(N.project(p) - p), norm(N.project(y) - y)),
        worst(jnp.max(jnp.abs(P @ P - P)), jnp.abs(jnp.trace(P) - N.dim)),
        worst(norm(N.tangent_projection(y, du) - du), norm(push(N.project, p, u) - u)),
        worst(norm(back - u), norm(linear)),
        worst(norm(N.exp(p, 0 * u) - p), norm(N.project(q) - q)),
        worst(norm(start[1] - w), *(jnp.abs(s - wanted) / scale for s in speed2)),
        jnp.abs(change - 2 * work) / scale,
        worst(*map(norm, straight)),
        worst(norm(form(p, w, w) - start[2]), norm(form(p, u, v) - form(p, v, u))),
        worst(*map(norm, lengths)),
        worst(*(jnp.abs(d) / scale for d in distances)),
        worst(jnp.abs(first(zero)), jnp.abs(second(zero) - 2 * inner(p, u, u))) / scale,
        jnp.abs(pull) / (scale * jnp.sqrt(inner(q, pulled, pulled)) / unit),
        worst(norm(N.residual(p, p)), norm(missed - N.orthonormal(p, u))),
    )
