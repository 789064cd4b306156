"""From trials to coefficients: segmentation, fits, uncertainty, tuning rules; pure functions over loaded runs."""
