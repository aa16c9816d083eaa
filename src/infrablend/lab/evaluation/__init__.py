"""How good a detector is: average precision, strata, intervals, tracks."""
