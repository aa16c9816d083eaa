"""One frame, from its background to its picture and labels; `frame` is the straight line through it."""
