"""Random but plausible vectors of a layout."""

import numpy as np

from aerotact.ports import Array, Layout


def sample(layout: Layout, rng: np.random.Generator, spread: float = 1.0) -> Array:
    """The layout's defaults, each number moved by up to `spread` and half of itself; quaternions stay of length one."""
    flat = layout.default * rng.uniform(0.5, 1.5, layout.size) + spread * rng.uniform(-1.0, 1.0, layout.size)
    for port in layout:
        view = flat[layout.slice(port.name)].reshape(port.nodes, port.size)
        if port.kind == "quaternion":
            view[:] = rng.normal(size=view.shape)
            view /= np.linalg.norm(view, axis=1, keepdims=True)
        if port.kind == "flag":
            view[:] = rng.integers(0, 2, size=view.shape)
    return flat
