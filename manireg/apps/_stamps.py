"""Times, every digit of them: as files write them, and as arrays."""

from decimal import ROUND_FLOOR, Decimal, localcontext
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .._input.numbers import Numbers

UNITS = {"ns": Decimal("1e-9"), "us": Decimal("1e-6"), "ms": Decimal("1e-3")}
SIZES = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))  # since 1970, of this century
DIGITS = 50


class Stamps(NamedTuple):
    """Numbers, exactly, in a unit."""

    exact: tuple[Decimal, ...]
    unit: Decimal = Decimal(1)
    """Seconds."""

    @staticmethod
    def of(texts: list[str], unit: str | None) -> "Stamps":
        """`unit`: "ns", "us", "ms", "s"; None: told by their size, which is that of times
        since 1970 in the finest of these, else seconds."""
        exact = tuple(map(Decimal, texts))
        largest = max(map(abs, exact))
        if unit is None:
            unit = next((u for size, u in SIZES if largest > size), "s")
        return Stamps(exact, UNITS.get(unit, Decimal(1)))

    @staticmethod
    def at_rate(count: int, rate: float) -> "Stamps":
        """From 0, in seconds."""
        with localcontext(prec=DIGITS):
            per = Decimal(repr(float(rate)))
            return Stamps(tuple(round(i / per, 9) for i in range(count)))

    @property
    def first(self) -> Decimal:
        """In seconds."""
        with localcontext(prec=DIGITS):
            return min(self.exact) * self.unit

    def seconds(self, first: Decimal) -> Float[np.ndarray, " k"]:
        """Since `first`: the differences are exact before they are floats."""
        with localcontext(prec=DIGITS):
            return np.array([float(t * self.unit - first) for t in self.exact])

    def texts(self) -> list[str]:
        """As plain decimals."""
        return [f"{t:f}" for t in self.exact]

    def take(self, indices: np.ndarray) -> "Stamps":
        return self._replace(exact=tuple(self.exact[i] for i in indices))

    def every(self, rate: float) -> "Stamps":
        """From the first to the last, so many a second, to the digit that these have, at
        least to the nanosecond."""
        with localcontext(prec=DIGITS):
            per, start = Decimal(repr(float(rate))) * self.unit, min(self.exact)
            count = int((max(self.exact) - start) * per) + 1
            found = (start + i / per for i in range(count))
            digit = Decimal(1).scaleb(-self._digits)
            return self._replace(
                exact=tuple(t.quantize(digit, ROUND_FLOOR) for t in found)
            )

    def with_gaps_filled(self, gaps: list, step: float) -> "Stamps":
        """In order, with times about a `step` of seconds apart within gaps (start and end
        in seconds since the first)."""
        found = set(self.exact)
        with localcontext(prec=DIGITS):
            for gap in gaps:
                count = max(round((gap.end - gap.start) / step), 1)
                inner = np.linspace(gap.start, gap.end, count + 1)[1:-1].tolist()
                for t in inner:
                    exact = min(self.exact) + Decimal(repr(t)) / self.unit
                    found.add(round(exact, self._digits))
        return self._replace(exact=tuple(sorted(found)))

    @property
    def _digits(self) -> int:
        """After the point."""
        finest = min(int(t.normalize().as_tuple().exponent) for t in self.exact)
        least = 0 if self.unit < 1 else 9
        return max(-finest, least)


def first_of(times: Numbers) -> Any:
    """The least, of the type it has."""
    array = np.asarray(times)
    if array.ndim != 1 or not len(array):
        raise ValueError(f"times: expected shape (k,), found {array.shape}.")
    return array.min()


def seconds_since(times: Numbers, first: Any, unit: float) -> Float[np.ndarray, " k"]:
    """Differences are exact before they are floats."""
    array = np.asarray(times)
    if array.dtype.kind in "mM":
        return (array - first) / np.timedelta64(1, "s")
    if array.dtype.kind == "u":
        array, first = array.astype(object), int(first)
    return np.asarray(array - first, float) * unit
