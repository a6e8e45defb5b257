"""What a manifold may leave to automatic differentiation."""
