"""Other programs' files to runs: a map says what a file means, nothing is guessed, nothing is mended."""
