"""What a law of a manifold is."""

from typing import NamedTuple


class Law(NamedTuple):
    statement: str
    method: str
    """That is at fault where it is broken."""
    cure: str
