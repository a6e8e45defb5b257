r"""What a residual costs: robust losses, which let go of outliers.

Each is a function of $s = |r|^2 / \sigma^2$, the squared length of a residual in units of
its scale, and equals s for small s, so that lambda keeps its meaning.
"""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, ScalarLike

from .._sources.checks import check_positive
from .efficiency import efficient_radius

S = Float[Array, "..."]


def _number(name: str, value: Any) -> Float[Array, ""]:
    demand = "must be positive and finite"
    return check_positive(
        name, value, demand, "It is a number of the order of 1 to 10."
    )


def _radius(name: str, value: Any) -> Float[Array, ""] | None:
    return None if value is None else _number(name, value)


class AbstractLoss(eqx.Module):
    r"""$\rho(s)$, $s = |r|^2 / \sigma^2 \ge 0$, of which the fit minimises the mean over
    the data. One of your own overrides `rho`, with $\rho(0) = 0$, $\rho'(0) = 1$ and two
    derivatives: $\rho'(s)$ is the weight a datum is left with."""

    redescending: ClassVar[bool] = True
    r"""Whether the pull $\sqrt{s} \rho'(s)$ of a datum vanishes as it goes off. If so,
    there may be several minima, and which one is found depends on the start."""

    @abc.abstractmethod
    def rho(self, s: S) -> S:
        """Elementwise. Finite derivatives at s = 0, where a square root has none."""

    def in_dimension(self, n: int) -> "AbstractLoss":
        """With the numbers that were left to the dimension n of the target; here the loss
        itself, which has none."""
        return self


class Squared(AbstractLoss):
    r"""$\rho(s) = s$: the likelihood of Gaussian noise, not robust."""

    redescending = False

    def rho(self, s: S) -> S:
        return s


class Huber(AbstractLoss):
    r"""$\rho(s) = s$ for $\sqrt{s} \le c$, beyond $2 c \sqrt{s} - c^2$: outliers pull with
    a constant force. Convex as a function of the residual.

    ```python
    mr.Huber()     # 95 % efficient
    mr.Huber(2.0)  # closer to squares
    ```

    - `c`: radius in standard deviations. By default the one at which noise that is
      Gaussian after all costs 5 % of efficiency: 1.345 of targets of dimension n = 1,
      then 1.501, 1.628, 1.731, 1.812, 1.869, and 1.897 from 7 on.

    Raises ValueError unless c is positive and finite. After Huber (1964), Ann. Math.
    Statist. 35, 73."""

    references = ("huber1964robust",)

    c: Float[Array, ""] | None = eqx.field(
        default=None, converter=lambda v: _radius("Huber: c", v)
    )
    redescending = False

    def rho(self, s: S) -> S:
        c = _known(self, self.c)
        far = s > c**2
        root = jnp.sqrt(jnp.where(far, s, 1.0))
        return jnp.where(far, c * (2 * root - c), s)

    def in_dimension(self, n: int) -> "Huber":
        # Above n = 7 the radius would shrink again, to 0 at n = 10, where the geometric
        # median (c = 0) itself is 95 % efficient. The radius of n = 7 is more so.
        return Huber(efficient_radius(Huber, min(n, 7))) if self.c is None else self


class Tukey(AbstractLoss):
    r"""$\rho(s) = \frac{c^2}{3} (1 - (1 - s/c^2)^3)$ for $\sqrt{s} \le c$, beyond
    $c^2 / 3$: data farther off than c have no weight at all. Not convex: start it from a
    fit with `Huber()`.

    ```python
    mr.Tukey()     # 95 % efficient
    mr.Tukey(6.0)
    ```

    - `c`: radius in standard deviations. By default the one at which noise that is
      Gaussian after all costs 5 % of efficiency: 4.685 of targets of dimension n = 1,
      then 5.123, 5.490, 5.810, 6.096, 6.356, ...

    Raises ValueError unless c is positive and finite. After Beaton, Tukey (1974),
    Technometrics 16, 147."""

    references = ("beaton1974fitting",)

    c: Float[Array, ""] | None = eqx.field(
        default=None, converter=lambda v: _radius("Tukey: c", v)
    )

    def rho(self, s: S) -> S:
        c = _known(self, self.c)
        near = jnp.minimum(s, c**2)
        u = near / c**2
        return near * (1 - u + u**2 / 3)  # multiplied out: nothing cancels

    def in_dimension(self, n: int) -> "Tukey":
        return Tukey(efficient_radius(Tukey, n)) if self.c is None else self


class StudentT(AbstractLoss):
    r"""$\rho(s) = \nu \log(1 + s / \nu)$: heavy tails, weights $\nu / (\nu + s)$. Not
    convex: the pull of a datum falls beyond $\sqrt{s} = \sqrt{\nu}$, but never to zero.

    Minus twice the logarithm of the density of Student's t in n dimensions is
    $(\nu + n) \log(1 + s / \nu)$, with weights $(\nu + n) / (\nu + s)$: that is
    $(\nu + n) / \nu$ times what is taken here, which is s for small s, as the other
    losses are. The factor moves into lambda; fits are the same.

    ```python
    mr.StudentT()
    mr.StudentT(2.0)  # more outliers
    ```

    - `nu`: degrees of freedom. Large ones: Gaussian noise; 1: Cauchy's.

    Raises ValueError unless nu is positive and finite. After Lange, Little, Taylor
    (1989), J. Am. Statist. Assoc. 84, 881."""

    references = ("lange1989robust",)

    nu: Float[Array, ""] = eqx.field(
        default=4.0, converter=lambda v: _number("StudentT: nu", v)
    )

    def rho(self, s: S) -> S:
        return self.nu * jnp.log1p(s / self.nu)


def check_loss(loss: Any) -> AbstractLoss:
    """`"squared"` or a loss."""
    if isinstance(loss, AbstractLoss):
        return loss
    if isinstance(loss, str) and loss == "squared":
        return Squared()
    if isinstance(loss, str) and loss in ("chord", "geodesic"):
        raise ValueError(
            f"loss: {loss!r} is a distance; take `distance={loss!r}`. The loss is what "
            "the distance costs, by default its square."
        )
    found = repr(loss)
    if isinstance(loss, type):
        called = issubclass(loss, AbstractLoss)
        found = f"the class {loss.__name__}" + ", without its ()" * called
    raise ValueError(
        "loss: expected 'squared', Squared(), Huber(), Tukey(), StudentT() or another "
        f"AbstractLoss, found {found}."
    )


def _known(loss: AbstractLoss, c: ScalarLike | None) -> ScalarLike:
    if c is None:
        name = type(loss).__name__
        raise ValueError(
            f"{name}: c depends on the dimension of the target; take {name}(c), or "
            f"{name}().in_dimension(n)."
        )
    return c
