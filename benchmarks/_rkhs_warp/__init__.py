"""The "RKHS warp after [12]" of the heads' table: kernels warp space, coarse to fine."""

from .warp import rkhs_warp as rkhs_warp
