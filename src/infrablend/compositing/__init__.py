"""From a rendered crop and a background to the finished picture."""
