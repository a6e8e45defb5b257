"""How often things are compiled, and that what is compiled goes again."""

import gc
import weakref
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from curves import INTERVAL

import manireg as mr
from manireg._programs.program import program
from manireg._programs.sizes import at_each, bucket, data_bucket, fewest_data, filled


@pytest.fixture
def compiled(monkeypatch):
    """Names of what is compiled from here on."""
    names = []

    def listen(event: str, duration_secs: float, **more: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            names.append(more.get("fun_name"))

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield names
    jax.monitoring.unregister_event_duration_listener(listen)


def track(k: int):
    """k noisy points of a curve on the sphere."""
    rng = np.random.default_rng(k)
    x = np.sort(rng.uniform(size=k))
    y = np.stack([np.cos(3 * x), np.sin(3 * x), np.sin(5 * x)], axis=1)
    y += 0.05 * rng.normal(size=y.shape)
    return x, y / np.linalg.norm(y, axis=1, keepdims=True)


def test_sizes():
    assert [bucket(n) for n in (1, 2, 3, 4, 5, 7, 9, 13, 97)] == [
        1, 2, 3, 4, 6, 8, 12, 16, 128,
    ]  # fmt: skip
    assert all(n <= bucket(n) <= 1.5 * n for n in range(2, 5000))
    assert [data_bucket(k) for k in (1, 48, 49, 768, 769)] == [48, 48, 192, 768, 1024]
    for size in {data_bucket(k) for k in range(1, 5000)}:
        fewest = fewest_data(size)
        assert data_bucket(fewest) == size
        assert fewest == 1 or data_bucket(fewest - 1) < size
    np.testing.assert_array_equal(filled([[1, 2], [3, 4]], 4)[:, 0], [1, 3, 1, 1])


def test_rows_of_any_number_by_few_programs(compiled):
    def shifted(owner, x, y):
        return owner + x * y, jnp.sum(x)

    owner, sizes = jnp.arange(3.0), (1, 5, 16, 17, 60, 5000)
    for n in sizes:
        x = np.random.default_rng(n).normal(size=(n, 3))
        product, total = at_each(shifted, owner, x, 2 * x)
        np.testing.assert_allclose(product, np.arange(3.0) + 2 * x**2)
        np.testing.assert_allclose(total, x.sum(1), atol=1e-12)
    runs = [name for name in compiled if name == "jit(run)"]
    assert len(runs) == 3  # of 16, 64 and 4096 rows


def test_the_programs_used_longest_ago_are_dropped():
    traced = []

    @program(most=2)
    def double(x, factor):
        traced.append((x.shape, factor))
        return factor * x, "a text", None

    for n in (1, 2, 1, 3, 1, 2):
        found, text, nothing = double(jnp.ones(n), 2.0)
        np.testing.assert_array_equal(found, np.full(n, 2.0))
        assert (text, nothing) == ("a text", None)
    assert traced == [((1,), 2.0), ((2,), 2.0), ((3,), 2.0), ((2,), 2.0)]
    double(jnp.ones(2), 3.0)  # a Python number belongs to the program
    assert traced[-1] == ((2,), 3.0)
    inside = jax.jit(lambda x: double(x, 2.0)[0])(jnp.ones(4))
    np.testing.assert_array_equal(inside, np.full(4, 2.0))


def test_a_program_dropped_frees_what_it_held():
    class Held:
        """Hashable, and not an array: belongs to the program."""

    @program(most=1)
    def plus_one(x, held):
        return x + 1

    held = Held()
    gone = weakref.ref(held)
    plus_one(jnp.ones(1), held)
    del held
    plus_one(jnp.ones(1), None)
    gc.collect()
    assert gone() is None


def test_data_of_similar_size_compile_nothing(compiled):
    """Nor do other intervals, and queries of other numbers."""
    sphere, options = mr.Sphere(2), dict[str, Any](progress=False)
    model = mr.fit(mr.Interval(0, 1), sphere, *track(70), **options)
    model(np.linspace(0, 1, 50))
    compiled.clear()
    for k, b in ((65, 1.0), (96, 2.0)):
        model = mr.fit(mr.Interval(0, b), sphere, *track(k), **options)
        model(np.linspace(0, 1, k))
        mr.fit(mr.Interval(0, b), sphere, *track(k), 1e-4, starts=(1.0,))
        compiled[:] = [name for name in compiled if k == 96]
    assert compiled == []


def test_transforms_of_a_model_compile_once(compiled):
    """Outside of `jit`, too, where loops would be compiled at every call."""
    model = mr.fit(mr.Interval(0, 1), mr.Sphere(2), *track(40), 1e-4, starts=(1.0,))
    values, slopes = jax.vmap(model), jax.vmap(jax.jacfwd(model))
    x = jnp.linspace(0, 1, 7)
    jax.block_until_ready((values(x), slopes(x)))
    compiled.clear()
    np.testing.assert_allclose(values(x), model(x), atol=1e-12)
    assert compiled.count("jit(_evaluate_traced)") == 0
    slopes(x)
    assert compiled == [name for name in compiled if name == "jit(run)"]


def test_what_is_filled_up_counts_for_nothing():
    """The same fit, errors of data left out and folds as without."""
    x, y = track(40)
    problem = mr.make_problem(INTERVAL, mr.Sphere(2), x, y, centres=20)
    alone = mr.leave_one_out(problem, [1e-4], progress=False)
    more = np.concatenate([x, x[:20]]), np.concatenate([y, -y[:20]])
    weights = np.repeat([1.0, 0.0], [40, 20])
    padded = mr.leave_one_out(
        INTERVAL, mr.Sphere(2), *more, [1e-4], weights=weights, centres=20, progress=False
    )  # fmt: skip
    assert padded.scores.shape == alone.scores.shape == (40, 1)
    np.testing.assert_allclose(padded.scores, alone.scores, rtol=1e-6)
    q = np.linspace(0, 1, 9)
    np.testing.assert_allclose(padded.model(q), alone.model(q), atol=1e-9)


@pytest.mark.slow
def test_many_sizes_in_one_process():
    """Few maps of memory, of which a process has 65,530."""
    for k in range(30, 530, 12):
        mr.fit(mr.Interval(0, 1), mr.Sphere(2), *track(k), progress=False)
    with open("/proc/self/maps") as maps:
        assert sum(1 for _ in maps) < 20_000
