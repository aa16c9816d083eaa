"""How good a detector is: detections, average precision, strata, intervals. Pure functions of data, no torch."""
