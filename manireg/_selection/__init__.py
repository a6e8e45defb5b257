"""Which lambda: scores, grids, paths along lambda."""
