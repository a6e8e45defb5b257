"""Numbers and matrices. Knows no geometry."""
