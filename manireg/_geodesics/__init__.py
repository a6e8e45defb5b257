"""Shortest curves of any manifold."""
