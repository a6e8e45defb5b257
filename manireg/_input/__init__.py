"""Numbers as people hand them in, and as messages show them. Knows no geometry."""
