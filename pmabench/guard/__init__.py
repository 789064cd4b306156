"""The only code that may command an output: limits on what the device will really get, and the safe state."""
