"""Where source and target meet. Start at `objective.py`."""
