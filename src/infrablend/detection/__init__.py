"""Running a detector and reading detections: prediction, tiles, matching with labels, intervals. No scores.

`infrablend.lab` computes average precision from the matches; here is what a user's own pictures need.
"""
