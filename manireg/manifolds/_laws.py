"""The laws of a manifold, as a test that anyone can run on a manifold of their own."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from ._base import AbstractManifold


def check_manifold(
    manifold: AbstractManifold,
    points: Float[Array, "k ..."],
    key: PRNGKeyArray | None = None,
    atol: float = 1e-6,
) -> dict[str, float]:
    """Checks that the methods of a manifold have the right shapes, agree with each
    other and have the derivatives that a regression needs.

    **Arguments:** `points` on the manifold, `(k, *point_shape)`, a handful; `key` for
    the random directions; `atol` the largest violation that passes, for lengths in
    units of the smaller of `reach` and `injectivity_radius / pi` (1 if infinite).

    **Returns:** the largest violation of each law.

    **Raises:** ValueError for the first law broken, with the method, the size of the
    violation, the point and what to look at.
    """
    if jnp.result_type(float) != jnp.float64:
        raise ValueError(
            "check_manifold: the laws need float64, which is off; switch it on first "
            'thing in the program: `jax.config.update("jax_enable_x64", True)`.'
        )
    name = type(manifold).__name__
    points = jnp.asarray(points, float)
    if points.shape[1:] != manifold.point_shape or len(points) == 0:
        raise ValueError(
            "check_manifold: `points` must have shape (k, *point_shape), k >= 1, with "
            f"point_shape = {manifold.point_shape}; found {points.shape}."
        )
    _check_shapes(manifold)
    radii = {}
    for radius in ("reach", "injectivity_radius"):
        radii[radius] = float(np.asarray(getattr(manifold, radius)))
        if not radii[radius] > 0:
            raise ValueError(
                f"check_manifold: `{name}.{radius}` must be positive, found "
                f"{radii[radius]}."
            )
    unit = min(radii["reach"], radii["injectivity_radius"] / np.pi)
    unit = unit if np.isfinite(unit) else 1.0
    lengths = [unit, *(r if np.isfinite(r) else unit for r in radii.values())]
    key = jax.random.key(0) if key is None else key
    found = _violations(manifold, points, key, *map(jnp.array, lengths))
    violations = jax.device_get(found)
    for law in _LAWS:
        violation = violations[law.statement]
        violation = np.where(np.isnan(violation), np.inf, violation)
        worst = int(np.argmax(violation))
        if not violation[worst] <= atol:
            size = f"by {violation[worst]:.3g}, more than atol = {atol:.3g},"
            if np.isinf(violation[worst]):
                size = "by a value that is not finite"
            raise ValueError(
                f"check_manifold: `{name}.{law.method}` breaks the law\n"
                f"    {law.statement}\n{size} at point {worst}:\n{points[worst]}\n"
                f"{law.cure}"
            )
    return {law.statement: float(violations[law.statement].max()) for law in _LAWS}


class _Law(NamedTuple):
    statement: str
    method: str
    cure: str


# From causes to consequences: the first one broken is the one to look at.
_LAWS = (
    _Law(
        "project(p) = p",
        "project",
        "If the point lies on the manifold, `project` moves it; else check `points`.",
    ),
    _Law(
        "project(project(x)) = project(x)",
        "project",
        "It must end on the manifold: iterate to convergence.",
    ),
    _Law(
        "tangent_projection is symmetric and idempotent",
        "tangent_projection",
        "It must be the orthogonal projection, P = P^T = P^2: check scale factors.",
    ),
    _Law(
        "tangent_projection has rank dim",
        "tangent_projection",
        "Its trace is its rank: check `dim`, or directions lost or left in.",
    ),
    _Law(
        "D project(p)[w] = tangent_projection(p, w), in forward and reverse mode",
        "tangent_projection",
        "Either it projects on another space than the tangent space of what `project` "
        "projects on, or the derivative rule of `project` is wrong.",
    ),
    _Law(
        "x - project(x) is normal",
        "project",
        "It must return the closest point, not just some point of the manifold.",
    ),
    _Law(
        "D project and D^2 project agree with finite differences",
        "project",
        "Its derivative rule is wrong off the manifold, or it is not smooth there; an "
        "iteration needs `implicit_solution` or `implicit_projection`.",
    ),
    _Law(
        "project(p +- normal) = p within 0.7 reach",
        "project",
        "It must return the closest point; if it does, `reach` is too large.",
    ),
    _Law(
        "tangent_projection(x, w) = tangent_projection(project(x), w)",
        "tangent_projection",
        "Off the manifold it must project on the tangent space at the closest point.",
    ),
    _Law(
        "second_fundamental_form(p, u, v) = D^2 project(p)[u, v]",
        "second_fundamental_form",
        "Check its sign and factors; `second_form_of_projection` computes it.",
    ),
    _Law(
        "second_fundamental_form(p, u, v) = D tangent_projection(p, v)[u]",
        "tangent_projection",
        "Its derivative in p is wrong: it may be constant in p, or hold a wrong rule.",
    ),
    _Law(
        "second_fundamental_form is symmetric and normal",
        "second_fundamental_form",
        "II(u, v) = II(v, u), without tangent part, for tangent u, v.",
    ),
    _Law("exp(p, 0) = p", "exp", "Check v = 0, and 0/0 in sin |v| / |v|."),
    _Law(
        "project(exp(p, v)) = exp(p, v)",
        "exp",
        "Its end points leave the manifold: check the scale of v.",
    ),
    _Law(
        "exp(p, t v) starts with velocity v and keeps its speed",
        "exp",
        "The geodesic must reach its end at time 1 with speed |v|.",
    ),
    _Law(
        "exp(p, t v) has normal acceleration",
        "exp",
        "The curve stays on the manifold but is no geodesic.",
    ),
    _Law(
        "log(p, exp(p, v)) = v and log(p, p) = 0",
        "log",
        "The test has |v| = injectivity_radius / 2; if `log` inverts `exp` for smaller "
        "v, `injectivity_radius` is too large.",
    ),
    _Law(
        "squared_distance(p, p) = 0",
        "squared_distance",
        "Compute it from p - q, not from 1 - <p, q>.",
    ),
    _Law(
        "squared_distance(p, exp(p, v)) = |v|^2",
        "squared_distance",
        "It must be the square of the length of the shortest geodesic: check factors.",
    ),
    _Law(
        "squared_distance(p, q) = squared_distance(q, p)",
        "squared_distance",
        "Check where p and q enter differently.",
    ),
    _Law(
        "squared_distance has gradient 0 and Hessian 2 I at coincidence",
        "squared_distance",
        "Not finite: arccos, sqrt or a norm at 0; write it as a smooth function of "
        "the squared chord |p - q|^2.",
    ),
    _Law(
        "the gradient of squared_distance(p, .) at q is -2 log(q, p)",
        "squared_distance",
        "Its derivative is wrong away from coincidence.",
    ),
    _Law(
        "random_points lie on the manifold and differ",
        "random_points",
        "Project them; draw a new sample for a new key.",
    ),
)


@eqx.filter_jit
def _violations(
    manifold: AbstractManifold,
    p: Array,
    key: PRNGKeyArray,
    unit: Array,
    reach: Array,
    injectivity_radius: Array,
) -> dict[str, Array]:
    """The size of the violation of each law at each point p, of shape (k,)."""
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

    # one geodesic, at the times 0 and 1
    w = 0.5 * injectivity_radius * v
    times = expand(jnp.array([0.0, 1.0])[:, None] * jnp.ones(len(p)))

    def velocity(t):
        return jax.jvp(lambda t: manifold.exp(p, t * w), (t,), (jnp.ones_like(t),))

    (ends, speeds), (_, accelerations) = jax.jvp(
        velocity, (times,), (jnp.ones_like(times),)
    )
    q = ends[1]
    logs = manifold.log(jnp.stack([p, q, p]), jnp.stack([q, p, p]))

    # squared distances with derivatives in the second argument
    d2 = manifold.squared_distance(jnp.stack([p, p, q]), jnp.stack([p, q, p]))

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

    values = (
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
        worst(norm(logs[0] - w), norm(logs[2])) / unit,
        jnp.abs(d2[0]) / unit**2,
        jnp.abs(d2[1] - inner(w, w)) / unit**2,
        jnp.abs(d2[1] - d2[2]) / unit**2,
        worst(norm(slope) / unit, norm(hessian - 2 * u)),
        norm(pull + 2 * logs[1]) / unit,
        worst(moved[3], jnp.where(norm(r[1:] - r[:1]) > 0, 0.0, jnp.inf)),
    )
    return {law.statement: v for law, v in zip(_LAWS, values, strict=True)}


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


def _check_shapes(manifold: AbstractManifold) -> None:
    """Traces every method on batches that broadcast and, under `vmap`, on one point;
    nothing is compiled."""
    name, shape = type(manifold).__name__, manifold.point_shape
    methods = {
        "project": (1, shape),
        "tangent_projection": (2, shape),
        "second_fundamental_form": (3, shape),
        "squared_distance": (2, ()),
        "exp": (2, shape),
        "log": (2, shape),
    }

    def traced(method, function, inputs, expected):
        try:
            found = jax.eval_shape(function, *inputs)
        except Exception as error:
            raise ValueError(
                f"check_manifold: `{name}.{method}` fails on inputs of shapes "
                f"{[x.shape for x in inputs]}; it must take leading batch dimensions "
                "that broadcast, and be traceable by `jit` and `vmap`."
            ) from error
        if found.shape != expected or found.dtype != jnp.float64:
            raise ValueError(
                f"check_manifold: `{name}.{method}` must return float64 of shape "
                f"{expected} for inputs of shapes {[x.shape for x in inputs]}, found "
                f"{found.dtype} of shape {found.shape}."
            )

    for method, (count, result) in methods.items():
        function = getattr(manifold, method)
        batches = [(2, 1), (3,), (2, 3)][:count]
        batch = np.broadcast_shapes(*batches)
        inputs = [jax.ShapeDtypeStruct(b + shape, float) for b in batches]
        traced(method, lambda *x, f=function: f(*x), inputs, batch + result)
        inputs = [jax.ShapeDtypeStruct((2, *shape), float)] * count
        traced(method, jax.vmap(function), inputs, (2, *result))
    key = jax.eval_shape(lambda: jax.random.key(0))
    draw = lambda key: manifold.random_points(key, 3)
    traced("random_points", draw, [key], (3, *shape))
