"""Which lambda: a score and a rule judge the fits of one path along log lambda. Knows
problems and how they are solved, not what they are made of."""
