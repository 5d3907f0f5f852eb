"""What several test modules share: makers of inputs of known truth, and ways to run the program."""
