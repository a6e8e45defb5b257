"""From what tables of directions say of their precision to standard deviations.

The mean of N unit vectors of a Fisher distribution of concentration kappa scatters about
the true one with the standard deviation 1 / sqrt(kappa N), in radians, along each of the
two tangent directions of the sphere; the angle between them exceeds r with the probability
exp(-kappa N r^2 / 2) (Fisher 1953, Proc. R. Soc. A 217, 295; Butler 1992, Paleomagnetism,
chapter 6). All this is for small angles: of means, for kappa N above 20 or so.
"""

import numpy as np
from jaxtyping import Float

from .numbers import Numbers, as_numbers
from .positive import refuse_other_than_positive

RADIUS_95 = np.sqrt(2 * np.log(20))  # sqrt of the 95 % quantile of chi^2_2, 2.448
_CURE = "Leave such data out; data that say nothing may also have the weight 0."


def from_a95(a95: Numbers) -> Float[np.ndarray, " k"] | float:
    r"""Standard deviations per tangent direction, in radians, of directions with
    95 % confidence radii `a95`, in degrees:

    $$\sigma = \frac{\pi}{180}\, \frac{\alpha_{95}}{\sqrt{\chi^2_2(0.95)}},
    \qquad \sqrt{\chi^2_2(0.95)} = \sqrt{2 \ln 20} = 2.448$$

    ```python
    mr.from_a95([2.4, 6.1])  # 0.0171, 0.0435
    ```

    - `a95`: a number, or those of k directions, `(k,)`: list, series or array.

    Of few directions alpha_95 is wider than the formula of `a95_of`, 9 % at N = 10 and 4 %
    at N = 20, as kappa is estimated from as few; sigma is then that much larger than that
    of `from_kappa`.

    Raises ValueError for radii that are zero, negative or missing. After Fisher (1953)
    and Butler (1992, chapter 6)."""
    return np.radians(_positive("a95", a95)) / RADIUS_95


def from_kappa(kappa: Numbers, n: Numbers = 1) -> Float[np.ndarray, " k"] | float:
    r"""Standard deviations per tangent direction, in radians, of means of `n` directions
    of concentration `kappa`:

    $$\sigma = \frac{1}{\sqrt{\kappa N}}$$

    ```python
    mr.from_kappa([120.0, 35.0], [8, 12])  # 0.0323, 0.0488
    ```

    - `kappa`: Fisher's concentration (K of tables, of dispersion), no unit; a number or
      those of k means, `(k,)`.
    - `n`: how many directions each mean is of: one for all, or `(k,)`. By default 1: the
      directions themselves.

    Raises ValueError for numbers that are zero, negative or missing. After Fisher (1953)
    and Butler (1992, chapter 6)."""
    return 1 / np.sqrt(_total(kappa, n))


def a95_of(kappa: Numbers, n: Numbers) -> Float[np.ndarray, " k"] | float:
    r"""95 % confidence radii, in degrees, of means of `n` directions of concentration
    `kappa`:

    $$\alpha_{95} = \frac{180°}{\pi}\, \sqrt{\frac{2 \ln 20}{\kappa N}}
    = \frac{140°}{\sqrt{\kappa N}}$$

    so that `from_a95(a95_of(kappa, n))` is `from_kappa(kappa, n)` (140 is 140.24).

    ```python
    mr.a95_of(120, 8)  # 4.53
    ```

    - `kappa`: Fisher's concentration, no unit; a number or those of k means, `(k,)`.
    - `n`: how many directions each mean is of: one for all, or `(k,)`.

    Raises ValueError for numbers that are zero, negative or missing. After Fisher (1953)
    and Butler (1992, chapter 6)."""
    return np.degrees(RADIUS_95) / np.sqrt(_total(kappa, n))


def _total(kappa: Numbers, n: Numbers) -> Float[np.ndarray, " k"] | float:
    """Concentration of the means."""
    kappa, n = _positive("kappa", kappa), _positive("n", n)
    if np.ndim(n) and np.ndim(kappa) and np.shape(n) != np.shape(kappa):
        raise ValueError(
            f"n: expected one number, or {np.size(kappa)}, one for each kappa, found "
            f"{np.size(n)}."
        )
    return kappa * n


def _positive(name: str, values: Numbers) -> Float[np.ndarray, " k"] | float:
    values = as_numbers(name, values)
    if values.ndim > 1:
        raise ValueError(
            f"{name}: expected a number or shape (k,), found {values.shape}."
        )
    refuse_other_than_positive(
        name, values.ravel(), "must be positive and finite", _CURE
    )
    return values if values.ndim else float(values)
