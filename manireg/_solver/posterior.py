"""How sure a fitted map is: the Laplace approximation around it (mathematics: 10.2,
10.4)."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from .._files import save
from .._input.numbers import Numbers
from .._objective.problem import number_of_data
from .._programs.sizes import at_each
from .._sources.checks import check_inputs
from ..manifolds import Sphere
from ..manifolds._defaults.frames import tangent_frames
from ..manifolds._matrices.turns import is_body
from .at_minimum import AtMinimum, at_minimum
from .derivatives import check_curve
from .diagnostics import diagnostics
from .equivalent_kernel import EquivalentKernel, equivalent_kernel
from .estimates import Estimate, MotionEstimate
from .information import ModelInformation
from .jet_covariances import JetsAt, jets_at, pushed
from .quantities import (
    Read,
    in_frame,
    motion,
    slope,
    turn_in_body,
    turn_in_space,
    twist_in_body,
    twist_in_space,
    velocity_in_frame,
)
from .regions import Region, conformal_radius, quantile_radius
from .smoothing import Mixture, Smoothing, mixture_of
from .spread import Spread
from .summary import Summary, summary_of

DRAWS = 1000  # maps that a band is made of


class Posterior(eqx.Module):
    r"""Of a fitted map, given lambda $w \sim N(\hat w, (2 \hat\sigma^2 / k) H^{-1})$: the
    likelihood is $\exp(-d^2 / 2 \sigma^2)$, the prior $\exp(-k \lambda S / 2 \sigma^2)$,
    and H the Gauss-Newton Hessian of the objective. Averaged over x, regions around the
    fit hold the true map as often as they say (Wahba 1983, Nychka 1988): they are wider
    than what noise alone does to the fit, by what smoothing may have taken off. (Measured
    on curves: with the exact Hessian semi-axes are the same to 0.6 %.) Deviations
    are from the fitted map, whatever lambda they come from.

    Made by `model.posterior()`.

    **Example:** where a pole was, a hundred million years ago.

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    interval, sphere = mr.Interval(0, 320), mr.Sphere(2)
    model = mr.fit(interval, sphere, data.ages, data.directions, 1e3)
    post = model.posterior()
    post.region(np.array([100.0])).theta95  # degrees
    post.sphere_motion(np.array([100.0])).speed_deviation  # radians a Myr
    ```
    """

    references = ("wahba1983bayesian", "nychka1988bayesian")

    model: Any
    seen: AtMinimum
    """The map from inside: H, leverages, how the data scatter."""
    mixture: Mixture
    """Of posteriors given lambda."""
    standardised: Float[np.ndarray, " k"]
    """Lengths of the residuals of left-out data in standard deviations of a new datum."""

    @property
    def spread(self) -> Spread:
        """How the data scatter."""
        return self.seen.spread

    @property
    def scale(self) -> float:
        r"""$2 \hat\sigma^2 / k$; NaN of a map through all its data."""
        return 2 * self.spread.variance / number_of_data(self.model.problem)

    def summary(self) -> Summary:
        """`model.summary()`, from what has been seen."""
        return summary_of(self.model, self.seen)

    def covariance(
        self, x: Numbers
    ) -> tuple[Float[np.ndarray, "q n n"], Float[np.ndarray, "q t n"]]:
        """Of the value at each of q points `x`, in an orthonormal frame of the tangent
        space of N there: covariances and frames (in flattened ambient coordinates).

        **Raises** ValueError as calling the map does."""
        _, jets, frames = self._values(x)
        return self._pushed(in_frame, jets, frames)[1], frames

    def sampling_covariance(
        self, x: Numbers
    ) -> tuple[Float[np.ndarray, "q n n"], Float[np.ndarray, "q t n"]]:
        r"""As `covariance`, but of the fit over repetitions of the noise,
        $H^{-1} (\sum_i J_i^\top J_i) H^{-1}$: what `mr.bootstrap` finds. Smaller than the
        posterior's, by about $\sqrt{1 - m / 2p}$: it lacks what smoothing takes off.

        **Raises** ValueError as calling the map does, and for latent inputs."""
        if self.model.problem.owner is not None:
            raise ValueError("sampling_covariance: not of maps with latent inputs.")
        _, jets, frames = self._values(x)
        information = ModelInformation.of(self.seen)
        covariance = self.scale * information.sampling(jets.rows, jets.near)
        return pushed(in_frame, self.model.target, jets, covariance, frames)[1], frames

    def region(
        self,
        x: Numbers,
        level: float = 0.95,
        *,
        simultaneous: bool = False,
        new: bool | float = False,
        key: PRNGKeyArray | None = None,
    ) -> Region:
        r"""Where the map is at each of q points `x`, with probability `level`.

        - `simultaneous`: a band, that holds the whole map over all of `x` with that
          probability: its radius is the quantile of the largest deviation of 1,000 drawn
          maps (`key`, default `jax.random.key(0)`).
        - `new`: True: where a new datum of mean precision would be; a number: one with
          that standard deviation. The radius is that within which as many of the data lie
          in the fits without them (conformal: Vovk et al. 2005; by the leverages), so that
          tails of the noise heavier than Gaussian are in it; of chi-squared where the data
          are too few for the level.

        **Raises** ValueError as calling the map does, for a level not between 0 and 1, and
        for a band of new data."""
        if simultaneous and new:
            raise ValueError(
                "region: `new` data are regions one by one; leave out one."
            )
        centre, jets, frames = self._values(x)
        covariance = self._pushed(in_frame, jets, frames)[1]
        n = covariance.shape[1]
        radius = quantile_radius(level, n)
        if simultaneous:
            radius = self._band(jets, covariance, frames, level, key)
        if new:
            spread = self.spread.variance if new is True else float(new) ** 2
            covariance = covariance + spread * np.eye(n)
            radius = conformal_radius(level, self.standardised, radius)
        return Region(self.model.target, centre, covariance, frames, radius, level)

    def sample(self, key: PRNGKeyArray, m: int) -> list[Any]:
        """`m` maps drawn at random, each a `RegressionMap`."""
        alone = dataclasses.replace(self.model, problem=None)
        w = np.asarray(self.model.coefficients)
        drawn = jax.device_put([w + d for d in self.mixture.draws(key, m)])
        return [dataclasses.replace(alone, coefficients=d) for d in drawn]

    def save(self, path: str | Path) -> None:
        """To an `.npz` file that `mr.load` reads, as `RegressionMap.save`."""
        save(self, path)

    def velocity(self, x: Numbers) -> Estimate:
        """`model.velocity(x)`, tangent vectors `(q, *point_shape)` per unit of x, with
        covariances in an orthonormal frame of the tangent space.

        **Raises** ValueError for sources of dimension 2 or more."""
        _, jets, frames = self._values(x, order=1)
        coordinates, covariance = self._pushed(velocity_in_frame, jets, frames)
        shape = self.model.target.point_shape
        velocity = np.einsum("qtn,qn->qt", frames, coordinates)
        return Estimate(velocity.reshape(-1, *shape), covariance, frames)

    def angular_velocity(self, x: Numbers, axes: str = "space") -> Estimate:
        """`angular_velocity` of a curve of rotations or poses, `(q, 3)` in radians per
        unit of x, about axes of the space or of the body, with its covariances.

        **Raises** ValueError for other targets, and names of axes."""
        read = turn_in_body if is_body(axes) else turn_in_space
        return self._moving(x, read)

    def twist(self, x: Numbers, axes: str = "space") -> Estimate:
        """Of a curve of poses, `SpecialEuclidean(3)`: angular velocity in radians, then
        that of the position, both per unit of x and along axes of the space or of the
        body, `(q, 6)`, with its covariances `(q, 6, 6)`.

        **Raises** ValueError for other targets, and names of axes."""
        return self._moving(x, twist_in_body if is_body(axes) else twist_in_space)

    def reading(self, x: Numbers, function: Callable) -> Estimate:
        """A quantity of your own: `function(value, velocity)` of a point on N and the
        velocity there, both of shape `point_shape`, in JAX; an array of numbers, with its
        covariance to first order. (A function of the same name that is made anew at every
        call is compiled anew, too.)

        **Raises** ValueError for sources of dimension 2 or more.

        **Example:** the rate of climb.

            post.reading(t, lambda p, v: v[2:])
        """
        return self._moving(x, Read(function))

    def _moving(self, x: Numbers, read: Callable) -> Estimate:
        _, jets, _ = self._values(x, order=1)
        return Estimate(*self._pushed(read, jets))

    def sphere_motion(self, x: Numbers, level: float = 0.95) -> MotionEstimate:
        """`sphere_motion` of a curve on the sphere: speed and azimuth with standard
        deviations, and the Euler pole with its region.

        **Raises** ValueError for other targets."""
        target = self.model.target
        if not isinstance(target, Sphere) or target.dim != 2:
            raise ValueError("sphere_motion: only of maps into Sphere(2).")
        _, jets, _ = self._values(x, order=1)
        values, covariance = self._pushed(motion, jets)
        speed, azimuth, poles = values[:, 0], values[:, 1], values[:, 2:]
        deviation = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
        globe = Sphere(2)
        frames = tangent_frames(globe, poles)
        reduced = np.swapaxes(frames, 1, 2) @ covariance[:, 2:, 2:] @ frames
        radius = quantile_radius(level, 2)
        region = Region(globe, jax.device_put(poles), reduced, frames, radius, level)
        parts = speed, deviation[:, 0], azimuth, deviation[:, 1]
        return MotionEstimate(*parts, region)

    def equivalent_kernel(self, x: Numbers) -> EquivalentKernel:
        r"""What the map at `x` rests on, for curves: the effective number of data,
        $1 / h(x)$ with $h(x) = \frac{2}{k} \frac{1}{n} \mathrm{tr}\, A H^{-1} A^\top$,
        A from the coefficients to the value: the leverage of a datum of mean precision at
        x, so that a plain mean of N data has N; and the width of the window, that of the
        running mean that would weigh its middle as much,
        $W = c\, (c \lambda k h)^{1 / (2p - 1)}$, $c = 2p \sin(\pi / 2p)$. Of data evenly
        spread it is 0.45 of the wavelength of lambda (p = 2). Silverman (1984, Ann.
        Statist. 12, 898) has the kernel.

            kernel = model.posterior().equivalent_kernel(ages)
            kernel.number, kernel.width

        **Raises** ValueError as calling the map does, and for sources of dimension 2 or
        more."""
        check_curve(self.model.source, "equivalent_kernel")
        _, jets, frames = self._values(x)
        problem = self.model.problem
        information = ModelInformation.of(self.seen)
        if problem.owner is not None:
            information = self.mixture.parts[0].information
        inverse = information.covariances(jets.rows, jets.near)
        inverse = pushed(in_frame, self.model.target, jets, inverse, frames)[1]
        return equivalent_kernel(problem, float(self.model.lam), inverse)

    def _values(self, x: Numbers, order: int = 0):
        """The map at `x`, its jets there, and frames of the tangent spaces."""
        if order:
            check_curve(self.model.source, "velocity")
        flat = np.asarray(check_inputs(self.model.source, x)[0])
        # which looks for uncovered points
        centre = self.model(self.model.source.from_ambient(flat))
        jets = jets_at(self.model, flat, order)
        return centre, jets, tangent_frames(self.model.target, np.asarray(centre))

    def _pushed(self, function, jets: JetsAt, *arrays):
        moment = self.mixture.second_moment(jets, self.model.basis)
        return pushed(function, self.model.target, jets, moment, *arrays)

    def _band(self, jets: JetsAt, covariance, frames, level, key) -> float:
        key = jax.random.key(0) if key is None else key
        drawn = self.mixture.draws(key, DRAWS)
        size, t = drawn.shape[1:]
        moved = jets.as_matrix(size) @ np.moveaxis(drawn, 0, 2).reshape(size, -1)
        slopes = at_each(slope, self.model.target, jets.psi[:, 0], frames)
        moved = slopes @ moved.reshape(len(frames), t, DRAWS)
        z = np.linalg.solve(np.linalg.cholesky(covariance), moved)
        largest = np.max(np.sum(z**2, axis=1), axis=0)
        return float(np.sqrt(np.quantile(largest, level)))


def posterior_of(model: Any, smoothing: Smoothing) -> Posterior:
    found = at_minimum(model)
    problem, spread = model.problem, found.spread
    each = diagnostics(problem, found, float(np.sqrt(spread.variance)))
    mixture = mixture_of(problem, found, smoothing)
    return Posterior(model, found, mixture, each.standardised)
