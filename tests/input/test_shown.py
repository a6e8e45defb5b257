import jax.numpy as jnp
import numpy as np
import pytest

from manireg._input.shown import shown


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.7e9 + 0.05, "1700000000.05"),
        (1.7e9, "1700000000"),
        (0.0, "0"),
        (-2.5, "-2.5"),
        (100, "100"),
        (2**60 + 1, "1152921504606846977"),
        (1.5e-7, "1.5e-07"),
        (1e22, "1e+22"),
        (0.1 + 0.2, "0.30000000000000004"),
        (np.float32(0.1), "0.1"),
        (np.float64(449000.123), "449000.123"),
        (jnp.asarray(0.25), "0.25"),
        (np.nan, "nan"),
        (-np.inf, "-inf"),
    ],
)
def test_shown(value, text):
    assert shown(value) == text


def test_shown_reads_back():
    rng = np.random.default_rng(0)
    values = rng.normal(size=200) * 10.0 ** rng.integers(-300, 300, 200)
    values = np.concatenate([values, np.nextafter(values, np.inf)])
    assert [float(shown(value)) for value in values] == values.tolist()
    assert len({shown(value) for value in values}) == 400
