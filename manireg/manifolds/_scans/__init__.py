"""Surfaces and curves known by points or triangles."""
