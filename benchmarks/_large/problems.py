"""The problems for K centres: `(source, target, x, y, arguments, lambda)`."""

import jax
import jax.numpy as jnp
import numpy as np

import manireg as mr

DATA = 25  # a centre: 100,000 at 4,000 centres
NOISE = 0.02
LAM = 1e-5
CLOUD = 200_000


def sphere(K: int, degree: int):
    """Noisy values of a smooth map of the sphere to itself."""
    S = mr.Sphere(2)
    x = S.random_points(jax.random.key(0), DATA * K)
    return S, S, x, _noisy(_to_sphere(x)), {"centres": K, "degree": degree}, LAM


def surface(K: int):
    """From the neighbourhood of a bumpy sphere known by 200,000 points to the sphere."""
    points, normals = _bumpy_sphere(CLOUD)
    source = mr.Ambient(mr.PointCloud(points, normals))
    chosen = np.random.default_rng(0).choice(CLOUD, DATA * K, replace=False)
    x = points[chosen]
    return source, mr.Sphere(2), x, _noisy(_to_sphere(x)), {"centres": K}, LAM


def _to_sphere(x):
    swirl = jnp.stack(
        [jnp.sin(3 * x[:, 1]), jnp.sin(2 * x[:, 2] + 1), jnp.cos(3 * x[:, 0])]
    )
    return mr.Sphere(2).project(jnp.asarray(x) + 0.3 * swirl.T)


def _noisy(y):
    noise = jax.random.normal(jax.random.key(1), y.shape)
    return mr.Sphere(2).project(y + NOISE * noise)


def _bumpy_sphere(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Zeros of |p| - r(p/|p|), quasi-uniform directions; normals are its gradient."""
    i = np.arange(n) + 0.5
    z, longitude = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    rho = np.sqrt(1 - z**2)
    u = jnp.stack([rho * np.cos(longitude), rho * np.sin(longitude), z], axis=1)

    def radius(u):
        return 1 + 0.1 * jnp.sin(4 * u[0]) * jnp.cos(3 * u[1] + u[2])

    def height(p):
        size = jnp.linalg.norm(p)
        return size - radius(p / size)

    points = jax.vmap(radius)(u)[:, None] * u
    return np.asarray(points), np.asarray(jax.vmap(jax.grad(height))(points))


PROBLEMS = {
    "sphere1": lambda K: sphere(K, 1),
    "sphere2": lambda K: sphere(K, 2),
    "surface": surface,
}
