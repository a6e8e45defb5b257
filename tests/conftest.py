import os

import jax
import matplotlib
import pytest

# most of a test is compilation: leave out XLA's optimisation (read when JAX first runs)
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")
jax.config.update("jax_enable_x64", True)
matplotlib.use("Agg")


@pytest.fixture
def key():
    return jax.random.key(0)


@pytest.fixture(scope="session")
def data_folder():
    """Folder of the shared data (`MANIREG_DATA`, default `../shared/data`)."""
    from manireg import datasets

    try:
        return datasets.data_folder()
    except FileNotFoundError as error:
        pytest.skip(str(error))
