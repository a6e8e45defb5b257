"""What the objective is a sum of: terms, each a residual at points of the source."""

import abc
from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree, ScalarLike

from .._discretisation.partial_derivatives import rows_of_order
from ..manifolds import AbstractManifold


class Jet(NamedTuple):
    """Of Psi at a point, in flattened ambient coordinates: partial derivatives along the
    frame E of the source there, intrinsic ones. No array of rows: reverse mode makes
    padded arrays of its slices, a third of the time of an exact Hessian."""

    value: Float[Array, " t"]
    first: tuple[Float[Array, " t"], ...] = ()
    """Along each vector E_a."""
    second: tuple[Float[Array, " t"], ...] = ()
    """Of (a, b), a <= b: (0, 0), (0, 1), ..., (m - 1, m - 1)."""
    third: tuple[Float[Array, " t"], ...] = ()
    """Of (a, b, c), a <= b <= c, likewise; where the energy has that order."""
    fourth: tuple[Float[Array, " t"], ...] = ()


def jet_of(rows: Float[Array, "J t"], m: int) -> Jet:
    """`m`: directions that are differentiated along."""
    all_rows, orders = jnp.unstack(rows), []
    while sum(map(len, orders)) < len(all_rows):
        orders.append(all_rows[rows_of_order(m, len(orders))])
    return Jet(orders[0][0], *orders[1:])


class AbstractTerm(eqx.Module):
    r"""A term of the objective, summed over the points of a place:

    $$f \sum_q w_q\, \rho(|r_q|^2), \qquad r_q = r(\Psi(x_q), D\Psi(x_q), D^2\Psi(x_q))$$

    At the place `"quadrature"` the sum is the integral over the source, at `"data"` the
    weighted mean over the data. Only `name`, `place`, `orders` and `residual` have to be
    given. Pull a map towards another one, `f`:

    ```python
    class Attraction(mr.AbstractTerm):
        f: Callable
        name = "attraction"
        place = "quadrature"
        orders = (0,)

        def arguments(self, x, y):
            return jax.vmap(self.f)(x)

        def residual(self, near, jet, f):
            p = jet.value.reshape(near.point_shape)  # jets are flattened
            return near.project(p) - f

    x = np.linspace(0, 1, 9)
    term = Attraction(lambda x: jnp.zeros(1))
    problem = mr.make_problem(
        mr.Interval(0, 1), mr.Euclidean(1), x, x[:, None], terms=(term,)
    )
    ```
    """

    name: ClassVar[str]
    """Under which `energies.terms` has its value."""
    place: ClassVar[Literal["quadrature", "data"]]
    orders: ClassVar[tuple[int, ...]]
    """Of the derivatives of Psi it reads: at quadrature points of 0 to 4, at data 0."""

    @abc.abstractmethod
    def residual(
        self, near: AbstractManifold, jet: Jet, args: PyTree
    ) -> Float[Array, "..."]:
        """r at one point, whose Jacobian is the Gauss-Newton model. `near`: the target, or
        the patch of a scan near Psi; `args`: what `arguments` gives for the point."""

    def arguments(
        self, x: Float[Array, "n s"], y: Float[Array, "n t"] | None
    ) -> PyTree[Float[Array, "n ..."]]:
        """Arrays with an entry for each point `x` (in ambient coordinates); at data `y` is
        given, too. Called once, where the problem is made. Default: none."""
        return ()

    def square(self, near: AbstractManifold, jet: Jet, args: PyTree):
        """$|r|^2$, by default of a residual of ambient coordinates."""
        return jnp.sum(self.residual(near, jet, args) ** 2)

    def rho(self, s: Float[Array, ""]) -> Float[Array, ""]:
        r"""What the square costs, by default itself. Robust losses grow more slowly; the
        Gauss-Newton model weighs residuals by $\rho'(|r|^2)$."""
        return s

    def factor(self, lam: ScalarLike, gamma: ScalarLike) -> ScalarLike:
        """f, by default 1. Energies take `lam`, the pull towards N takes `gamma`."""
        return 1.0

    def density(self, near: AbstractManifold, jet: Jet, args: PyTree):
        return self.rho(self.square(near, jet, args))


def weight_of(term: AbstractTerm, s: Float[Array, ""]) -> Float[Array, ""]:
    """rho'(s), held fixed: what Gauss-Newton multiplies the square with."""
    return jax.lax.stop_gradient(jax.grad(term.rho)(s))


def project_flat(
    target: AbstractManifold, psi: Float[Array, " t"]
) -> Float[Array, " t"]:
    r"""$\pi(\Psi)$ in flattened coordinates."""
    return target.project(psi.reshape(target.point_shape)).ravel()
