"""What x can live on, and whether data lie there. Knows no quadrature."""
