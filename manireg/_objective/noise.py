"""From what is known of the noise to what each datum weighs in the objective: precisions
relative to their mean, so that lambda keeps its meaning, and that mean itself."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from .._input.precision import as_scalar
from .._sources.checks import is_concrete
from .._sources.noise import Noise
from .losses import AbstractMisfit, GeodesicMisfit, WhitenedMisfit
from .robust import AbstractLoss, Squared


class Precision(eqx.Module):
    """Of the data, as the objective reads it."""

    relative: Float[Array, " k"] | Float[Array, "k n t"]
    """One number a datum, or factors F of the precision in T_yN; 1 is the mean (of the
    trace over n)."""
    mean: Float[Array, ""] | None
    """In units of N^-2, or None: only ratios are known."""
    scatter: float = 0.0
    r"""$\tau$, added to what is known."""
    phi: float | None = None
    r"""Reduced $\chi^2$ of the fit without it; None: not looked at."""
    log_densities: tuple[float, float] | None = None
    """Of left-out data, mean per direction: with a factor phi on the variances given, and
    with the scatter added."""

    @property
    def level(self) -> Float[Array, " k"]:
        """One number a datum, in any case."""
        q = self.relative
        return q if q.ndim == 1 else (q**2).sum((1, 2)) / q.shape[1]


def equal_precisions(k: int) -> Precision:
    return Precision(jax.device_put(np.ones(k)), None)


def precision_of(
    noise: Noise,
    shares: Float[np.ndarray, " k"] | Bool[np.ndarray, " k"],
    scatter: float = 0.0,
) -> Precision:
    r"""Of variances $\sigma_i^2 + \tau^2$ along each axis, $\tau$ = `scatter`; what is
    not known along an axis stays so. `shares` of the data in the mean."""
    known = np.asarray(noise.precisions)
    absolute = known / (1 + scatter**2 * known)
    each = absolute if noise.axes is None else np.mean(absolute, axis=1)
    mean = np.average(each, weights=shares)
    relative = absolute / mean
    if noise.axes is not None:
        roots = np.sqrt(relative)[:, :, None]
        relative = roots * np.swapaxes(np.asarray(noise.axes), 1, 2)
    return Precision(jax.device_put(relative), as_scalar(mean), scatter)


def misfit_of(precision: Precision, loss: AbstractLoss) -> AbstractMisfit:
    """The scale of a robust loss is that of the noise where it is known; else it has to
    be estimated, and is not a number until then."""
    scale = np.nan if precision.mean is None else float(precision.mean) ** -0.5
    scale = 1.0 if isinstance(loss, Squared) else scale
    kind = GeodesicMisfit if precision.relative.ndim == 1 else WhitenedMisfit
    return kind(loss, scale)


def check_scale(misfit: AbstractMisfit) -> None:
    """**Raises** ValueError where it was not given."""
    if is_concrete(misfit.scale) and np.isnan(np.asarray(misfit.scale)):
        raise ValueError(
            f"loss: {type(misfit.loss).__name__} counts in standard deviations, which are "
            "not known here. Give `sigma` or `precision`, or use `mr.fit`, which finds "
            "them from the data."
        )
