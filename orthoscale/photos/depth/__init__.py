"""The altitude of a photo by metric depth, to compare with the one by vehicles."""
