"""Training of detectors with Ultralytics, the extra `train`: the adapter to it and to torch."""
