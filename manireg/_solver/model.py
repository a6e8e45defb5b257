"""The fitted map."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from .._discretisation.local_polynomials import LocalPolynomials
from .._files import save
from .._input.numbers import Numbers
from .._input.precision import check_x64
from .._objective.objective import Energies
from .._objective.problem import Problem
from .._source import AbstractSource
from .._sources.checks import check_inputs, is_concrete
from ..manifolds import AbstractManifold
from .derivatives import (
    Differential,
    acceleration_at,
    check_curve,
    differential_at,
    velocity_at,
)
from .directions import curved
from .evaluation import at_covered, psi_at
from .posterior import Posterior, posterior_of
from .smoothing import Smoothing
from .summary import Summary, data_weights_of, summary_of


class RegressionMap(eqx.Module):
    """A fitted map from `source` to `target`: call it on new points."""

    source: AbstractSource
    target: AbstractManifold
    basis: LocalPolynomials
    origin: Float[Array, " t"]
    coefficients: Float[Array, "KC t"]
    """Of the basis, for what comes to `origin`."""
    lam: Float[Array, ""]
    energies: Energies
    result: optx.RESULTS
    stats: dict[str, Any]
    problem: Problem | None = None
    """What it was fitted to, for posteriors and summaries; None where the fit was traced
    (`jit`, `vmap`). `dataclasses.replace(model, problem=None)` is the map alone, in a
    small file."""

    __hash__ = object.__hash__  # `jax.jit(model)` asks for one

    def __call__(self, x: Numbers) -> Float[Array, "..."]:
        """Values at `x`, `(n, *source.point_shape)`: `(n, *target.point_shape)`, on the
        target. A single point, `(*source.point_shape)`, gives a single point, so
        `jax.vmap`, `jax.jit` and `jax.grad` take the model as it is.

        **Raises** ValueError for wrong shapes, NaN, points off the source or outside the
        cover of the fitted map, and for a model that was unpickled in float32 mode. Of
        traced `x` the values are not known: NaN and points outside an `Interval`, a `Box`
        or the cover are run-time errors (`equinox.error_if`); whether they lie on a curved
        source is not looked at: `source.project` them if in doubt.
        """
        return self._at(x, _value)

    def velocity(self, x: Numbers) -> Float[Array, "..."]:
        r"""$\Phi'(x)$ of the map $\Phi = \pi \circ \Psi$ from a source of dimension 1: at
        `x`, as for a call, tangent vectors `(n, *target.point_shape)`, or one at a single
        point.

        It is per unit of x as users write it: of an `Interval` (seconds, if x are dates),
        of the period of a `Circle`. Where x are points of a curve, `Sphere(1)` say, it is
        per unit of length along the frame of `differential`.

        **Raises** ValueError as a call does, and for sources of dimension 2 or more, which
        have a `differential`.

        **Example:** how fast a pole wanders, in degrees a million years.

        ```python
        data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
        interval, sphere = mr.Interval(0, 320), mr.Sphere(2)
        model = mr.fit(interval, sphere, data.ages, data.directions, 1e3)
        np.degrees(mr.sphere_motion(model(100.0), model.velocity(100.0)).speed)
        ```
        """
        check_curve(self.source, "velocity")
        return self._at(x, velocity_at, curved(self.source))

    def acceleration(self, x: Numbers) -> Float[Array, "..."]:
        r"""$D\Phi'/dx$, the covariant derivative of the `velocity` along the curve: the
        tangent part of its ambient derivative, zero for geodesics of constant speed.
        Shapes, units (per square of that of x) and errors as for `velocity`."""
        check_curve(self.source, "acceleration")
        return self._at(x, acceleration_at, curved(self.source))

    def differential(self, x: Numbers) -> Differential:
        r"""$d\Phi_x$ along an orthonormal frame $E_1, \dots, E_m$ of the source's tangent
        space, of any dimension m.

        **Arguments:** `x`: as for a call, and so are errors.

        **Returns** a named tuple, without n for a single point:

        - `derivatives`: `(n, *target.point_shape, m)`, tangent vectors of the target.
        - `frame`: `(n, s, m)`, columns $E_a$ in ambient coordinates of the source: the
          axes where the source is a part of a vector space (`Box`, `Ambient`), elsewhere
          some frame, which need not depend on x continuously.

        What does not depend on the frame: `derivatives @ frame^T`, its singular values.

        **Example:** by how much a map of the sphere stretches.

        ```python
        x = mr.Sphere(2).random_points(jax.random.key(0), 40)
        y = x * np.array([1.0, 1.2, 0.8])
        model = mr.fit(mr.Sphere(2), mr.Euclidean(3), x, y, 1e-9)
        stretch = jnp.linalg.svd(model.differential(x).derivatives, compute_uv=False)
        stretch.max().round(2) <= 1.2  # True
        ```
        """
        return self._at(x, differential_at, curved(self.source))

    def posterior(self, smoothing: Smoothing = "auto") -> Posterior:
        """How sure the map is: covariances, regions, bands, velocities, random maps; see
        `Posterior`.

        - `smoothing`: what is not known of lambda. `"known"`: nothing, as of one that you
          gave for reasons. `"linear"`: its error by the curvature of the restricted
          likelihood, the map to first order in log lambda. `"grid"`: a mixture of the fits
          at 5 to 30 lambdas, each as likely as its restricted likelihood says. `"auto"`
          (default): on curves the grid where the curvature is too small for first order,
          as where few data leave open whether the map bends at all; else linear.

        **Raises** ValueError for a map without its problem (fitted under `jit` or `vmap`,
        or stored alone)."""
        return posterior_of(self, smoothing)

    def _at(self, x: Numbers, function: Callable, *of_source: Any) -> Any:
        """`function` of the parts of the map, at checked points."""
        check_x64(self.basis)
        flat, single = check_inputs(self.source, x)
        owner = *of_source, self.target, self.coefficients, self.origin
        values = at_covered(function, self.basis, owner, flat)
        return jax.tree.map(lambda v: v[0], values) if single else values

    def save(self, path: str | Path) -> None:
        """Writes the map, with the problem it was fitted to, to an `.npz` file that
        `mr.load` reads, bit for bit. Manifolds, sources, terms and functions of your own
        are not in it: they are given to `mr.load` again.

        **Example:** `model.save("path.npz"); model = mr.load("path.npz")`.
        """
        save(self, path)

    def summary(self) -> Summary:
        """How it fits the data: what noise was found, how many parameters it took, which
        data are odd. `print` it, or read its fields."""
        return summary_of(self)

    @property
    def data_weights(self) -> Float[np.ndarray, " k"]:
        r"""What the loss leaves of each datum in the order of `y`: $\rho'(s_i)$, between 0
        and 1, of its squared residual s_i in units of the loss's scale; 1 for squares."""
        return data_weights_of(self)


def _value(owner, x, near):
    basis, (target, w, origin) = owner
    psi = psi_at((basis, (w, origin)), x, near)
    return target.project(psi.reshape(target.point_shape))


def regression_map(
    problem: Problem, w: Float[Array, "KC t"], lam, energies, result, stats
) -> RegressionMap:
    """The map with coefficients `w`."""
    source, target, basis = problem.source, problem.target, problem.basis
    fit = problem.origin, w, lam, energies, result, stats
    known = is_concrete(*jax.tree.leaves((problem, w)))
    return RegressionMap(source, target, basis, *fit, problem if known else None)
