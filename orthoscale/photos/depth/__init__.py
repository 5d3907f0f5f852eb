"""The altitude of a photo by a network for metric depth, beside the one by vehicles."""
