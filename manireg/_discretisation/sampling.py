"""Centres and quadrature for the data at hand."""

import numpy as np

from .._programs.sizes import bucket
from .._source import AbstractSource
from .domain import centres_of, discretise
from .following import follow
from .local_spacing import clustered_spacing
from .spacing import local_spacings

DEFAULT_CENTRES = {1: (32, 96), 2: (48, 384), 3: (64, 144)}  # least and most
CENTRES_PER_DATUM = {1: 1.0, 2: 0.4, 3: 0.8}  # in between
CLUSTERED = {1: 384, 2: 384, 3: 192}  # at most, where the data cluster


def sample(
    source: AbstractSource,
    x,
    centres: int | None,
    graded: bool,
    order: int,
    share: float = 1.0,
):
    """Centres, the spacing around them, quadrature, and the volume that the data fill: all
    of it, or where they cluster what they would fill at their median density. `share`: of
    the default number of centres."""
    m = source.sampled.dim
    low, high = DEFAULT_CENTRES.get(m, DEFAULT_CENTRES[3])
    wanted = CENTRES_PER_DATUM.get(m, CENTRES_PER_DATUM[3]) * len(x)
    default = round(share * int(np.clip(bucket(round(wanted)), low, high)))
    n = default if centres is None else centres
    domain = discretise(source, n, x, graded, order)
    volume = float(np.sum(np.asarray(domain.weights)))
    data = np.asarray(x)
    low = round(share * low)
    spacing = None
    if not graded and domain.isometric:  # which the volume is to be compared with
        spacing = clustered_spacing(data, m, volume, n, low)
    if spacing is not None:
        most = round(share * CLUSTERED.get(m, CLUSTERED[3]))
        most = most if centres is None else centres
        finer = centres is not None
        followed = follow(source, spacing, most, x, finer, order)
        if followed is not None:
            nodes, h, quadrature = followed
            return nodes, h, quadrature, spacing.data_volume
    nodes = centres_of(source, n, x, graded)
    if source.sampled.known_points() is not None or not domain.isometric:
        spacing = local_spacings(np.asarray(nodes.points), m)
    else:
        spacing = (volume / len(nodes.points)) ** (1 / m)
    return nodes, spacing, domain, volume
