"""Steps of `infrablend train`: plan, requirements, data, folder, process."""
