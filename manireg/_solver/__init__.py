"""From a problem and lambda to a map."""
