"""What a fitted map says, in the terms of a field. Knows no basis and no solver."""
