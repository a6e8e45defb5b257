"""What x can live on besides manifolds, and whether data lie there. Knows no
quadrature."""
