import gc
import os

import jax
import matplotlib
import pytest

# Most of a test is compilation: leave out XLA's optimisation, and its fusion emitters
# (half of the rest) where the flag exists: XLA dies of one it does not know.
FLAGS = "--xla_backend_optimization_level=0"
if jax.__version_info__ < (0, 11):
    FLAGS += " --xla_cpu_use_fusion_emitters=false"
os.environ.setdefault("XLA_FLAGS", FLAGS)
jax.config.update("jax_enable_x64", True)
matplotlib.use("Agg")


@pytest.fixture(scope="module", autouse=True)
def forget_programs():
    """Each compiled program takes dozens of memory maps, of which the kernel allows
    65,530 to a process: too few for all files."""
    yield
    jax.clear_caches()
    gc.collect()


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
