"""The laws of a manifold, as a test that anyone can run on a manifold of their own: of
one with the metric of the ambient space here, of others in `_metric_laws`."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from ._base import AbstractManifold
from ._law import Law
from ._metric_laws import METRIC_LAWS, metric_violations
from ._violations import violations


def check_manifold(
    manifold: AbstractManifold,
    points: Float[Array, "k ..."],
    key: PRNGKeyArray | None = None,
    atol: float = 1e-6,
    log_up_to: float = 0.9,
) -> dict[str, float]:
    """Checks that the methods of a manifold have the right shapes, agree with each
    other and have the derivatives that a regression needs.

    **Arguments:** `points` on the manifold, `(k, *point_shape)`, a handful; `key` for
    the random directions; `atol` the largest violation that passes, for lengths in
    units of the smaller of `reach` and `injectivity_radius / pi` (1 if infinite).
    Distances and `log` are tested at .5 and .9 of the injectivity radius, `log` at
    `log_up_to` of it, too: .999 is for a closed formula, which shooting cannot follow.
    (`squared_distance` is a loss and may be continued beyond .9, to stay smooth.)
    A manifold that is not `isometric` has laws of its own metric.

    **Returns:** the largest violation of each law.

    **Raises:** ValueError for the first law broken, with the method, the size of the
    violation, the point and what to look at.

    **Example:**

    ```python
    sphere = mr.Sphere(2)
    laws = mr.check_manifold(sphere, sphere.random_points(jax.random.key(0), 5))
    max(laws.values()) < 1e-6  # True
    ```
    """
    if jnp.result_type(float) != jnp.float64:
        raise ValueError(
            "check_manifold: the laws need float64, which is off; switch it on first "
            'thing in the program: `jax.config.update("jax_enable_x64", True)`.'
        )
    if not 0 < log_up_to < 1:
        raise ValueError(
            "check_manifold: `log_up_to` must lie between 0 and 1, a share of the "
            f"injectivity radius; found {log_up_to}."
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
    measures = map(jnp.array, (*lengths, float(log_up_to)))
    laws, measure = _LAWS, violations
    if not manifold.isometric:
        laws, measure = METRIC_LAWS, metric_violations
    found = jax.device_get(measure(manifold, points, key, *measures))
    for law, violation in zip(laws, found, strict=True):
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
    return {law.statement: float(v.max()) for law, v in zip(laws, found)}


# From causes to consequences: the first one broken is the one to look at.
_LAWS = (
    Law(
        "project(p) = p",
        "project",
        "If the point lies on the manifold, `project` moves it; else check `points`.",
    ),
    Law(
        "project(project(x)) = project(x)",
        "project",
        "It must end on the manifold: iterate to convergence.",
    ),
    Law(
        "tangent_projection is symmetric and idempotent",
        "tangent_projection",
        "It must be the orthogonal projection, P = P^T = P^2: check scale factors.",
    ),
    Law(
        "tangent_projection has rank dim",
        "tangent_projection",
        "Its trace is its rank: check `dim`, or directions lost or left in.",
    ),
    Law(
        "D project(p)[w] = tangent_projection(p, w), in forward and reverse mode",
        "tangent_projection",
        "Either it projects on another space than the tangent space of what `project` "
        "projects on, or the derivative rule of `project` is wrong.",
    ),
    Law(
        "x - project(x) is normal",
        "project",
        "It must return the closest point, not just some point of the manifold.",
    ),
    Law(
        "D project and D^2 project agree with finite differences",
        "project",
        "Its derivative rule is wrong off the manifold, or it is not smooth there; an "
        "iteration needs `implicit_solution` or `implicit_projection`.",
    ),
    Law(
        "project(p +- normal) = p within 0.7 reach",
        "project",
        "It must return the closest point; if it does, `reach` is too large.",
    ),
    Law(
        "tangent_projection(x, w) = tangent_projection(project(x), w)",
        "tangent_projection",
        "Off the manifold it must project on the tangent space at the closest point.",
    ),
    Law(
        "second_fundamental_form(p, u, v) = D^2 project(p)[u, v]",
        "second_fundamental_form",
        "Check its sign and factors; `second_form_of_projection` computes it.",
    ),
    Law(
        "second_fundamental_form(p, u, v) = D tangent_projection(p, v)[u]",
        "tangent_projection",
        "Its derivative in p is wrong: it may be constant in p, or hold a wrong rule.",
    ),
    Law(
        "second_fundamental_form is symmetric and normal",
        "second_fundamental_form",
        "II(u, v) = II(v, u), without tangent part, for tangent u, v.",
    ),
    Law("exp(p, 0) = p", "exp", "Check v = 0, and 0/0 in sin |v| / |v|."),
    Law(
        "project(exp(p, v)) = exp(p, v)",
        "exp",
        "Its end points leave the manifold: check the scale of v.",
    ),
    Law(
        "exp(p, t v) starts with velocity v and keeps its speed",
        "exp",
        "The geodesic must reach its end at time 1 with speed |v|.",
    ),
    Law(
        "exp(p, t v) has normal acceleration",
        "exp",
        "The curve stays on the manifold but is no geodesic.",
    ),
    Law(
        "log(p, exp(p, v)) = v and log(p, p) = 0",
        "log",
        "The tests have |v| = .5, .9 and `log_up_to` of the injectivity radius; if `log` "
        "inverts `exp` for smaller v, `injectivity_radius` is too large, or a factor "
        "theta / sin(theta) is lost in rounding: theta = 2 arctan2(|p - q|, |p + q|).",
    ),
    Law(
        "squared_distance(p, p) = 0",
        "squared_distance",
        "Compute it from p - q, not from 1 - <p, q>.",
    ),
    Law(
        "squared_distance(p, exp(p, v)) = |v|^2",
        "squared_distance",
        "It must be the square of the length of the shortest geodesic, up to .9 of the "
        "injectivity radius: check factors.",
    ),
    Law(
        "squared_distance(p, q) = squared_distance(q, p)",
        "squared_distance",
        "Check where p and q enter differently.",
    ),
    Law(
        "squared_distance has gradient 0 and Hessian 2 I at coincidence",
        "squared_distance",
        "Not finite: arccos, sqrt or a norm at 0; write it as a smooth function of "
        "the squared chord |p - q|^2.",
    ),
    Law(
        "the gradient of squared_distance(p, .) at q is -2 log(q, p)",
        "squared_distance",
        "Its derivative is wrong away from coincidence, at half the injectivity radius.",
    ),
    Law(
        "random_points lie on the manifold and differ",
        "random_points",
        "Project them; draw a new sample for a new key.",
    ),
)


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
