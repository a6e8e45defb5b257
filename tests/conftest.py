import gc
import os

import jax
import jaxtyping
import matplotlib
import pytest
from jax.experimental.compilation_cache import compilation_cache

# Most of a test is compilation: leave out XLA's optimisation, and its fusion emitters
# (half of the rest) where the flag exists: XLA dies of one it does not know.
FLAGS = "--xla_backend_optimization_level=0"
if jax.__version_info__ < (0, 11):
    FLAGS += " --xla_cpu_use_fusion_emitters=false"
os.environ.setdefault("XLA_FLAGS", FLAGS)
# Programs made with these flags are of no use to anyone else: commands that tests run
# must not fill the user's cache folder.
os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
jax.config.update("jax_enable_compilation_cache", False)
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
def jax_cache():
    """JAX's cache of compiled programs can be switched on in this test."""
    names = (
        "jax_compilation_cache_dir",
        "jax_enable_compilation_cache",
        "jax_persistent_cache_min_compile_time_secs",
        "jax_persistent_cache_min_entry_size_bytes",
    )
    before = {name: jax.config.values[name] for name in names}
    jax.config.update("jax_enable_compilation_cache", True)
    jax.config.update("jax_compilation_cache_dir", None)
    compilation_cache.reset_cache()
    yield
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()


@pytest.fixture
def unchecked():
    """Types are not checked in this test: wrong names reach the library, as users' do."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


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
