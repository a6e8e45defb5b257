"""The source made finite: centres, quadrature, basis, jets. Never sees the target."""
