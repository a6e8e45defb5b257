"""Compiled programs: few, because shapes come in few sizes, and no more than are used."""
