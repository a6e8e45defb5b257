"""A line search that lets the objective rise for a few steps.

The objective is stiff: a step along a curve's slow bend leaves the valley floor by the
square of its length, and the next step repairs that at once. A search that never lets the
objective rise shortens such steps until nothing moves (measured on curves that go on
beyond their data: 115 trials and more, now 14). So a full step that fails is taken all the
same, and only if a few of them together fail, the search goes back to where they began
and shortens: the watchdog of Chamberlain, Powell, Lemarechal and Pedersen (1982).
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Bool, Int, Scalar


class Verdict(eqx.Module):
    """On a trial point."""

    enough: Bool[Array, ""]
    """The objective is as low as it has to be."""
    accept: Bool[Array, ""]
    back: Bool[Array, ""]
    """Patience has ended: back to the reference."""
    shorter: Bool[Array, ""]
    """A shorter step from the reference."""


class Watchdog(eqx.Module):
    """State of the search."""

    y: Any
    """The reference: where full steps that need not succeed began."""
    f: Scalar
    goal: Scalar
    """What the objective has to reach."""
    steps: Int[Array, ""]
    """Taken since the reference."""
    length: Scalar
    """Of the step on trial, as a share of the Newton step."""
    forced: Bool[Array, ""]
    """On trial is no step but a start: accepted whatever the objective."""
    shortened: Bool[Array, ""]
    """The trial before was not accepted."""

    @classmethod
    def at(cls, y, dtype) -> "Watchdog":
        """To start from `y`."""
        zero, false = jnp.zeros((), dtype), jnp.array(False)
        one = jnp.ones_like(zero)
        return cls(y, zero, zero, jnp.array(0), one, jnp.array(True), false)

    def judge(self, f: Scalar, patience: int) -> Verdict:
        enough = self.forced | (f <= self.goal)
        patient = (self.length == 1) & (self.steps < patience)
        accept = enough | (patient & jnp.isfinite(f))
        away = self.steps > 0
        return Verdict(enough, accept, ~accept & away, ~accept & ~away)

    def next_length(self, verdict: Verdict) -> Scalar:
        after_return = self.forced & self.shortened
        length = jnp.where(verdict.shorter, self.length / 2, 1.0)
        return jnp.where(after_return, 0.5, length)

    def after(self, verdict: Verdict, y, f: Scalar, goal: Scalar) -> "Watchdog":
        """With `y` the last accepted point, f its value and `goal` that of the step from
        there. The step on trial next is `next_length` long; or it is the way back."""
        renewed = verdict.enough
        keep = lambda new, old: jnp.where(renewed, new, old)
        at_reference = renewed | verdict.shorter
        return Watchdog(
            jtu.tree_map(keep, y, self.y),
            keep(f, self.f),
            jnp.where(at_reference, goal, self.goal),
            jnp.where(at_reference, 0, self.steps + verdict.accept),
            self.next_length(verdict),
            verdict.back,
            ~verdict.accept,
        )
