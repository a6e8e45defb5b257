"""Manifolds of matrices, and the functions of matrices they need."""
