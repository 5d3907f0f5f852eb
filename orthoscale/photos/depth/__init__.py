"""The altitude of a photo by a metric depth network, for comparison with the one by vehicles."""
