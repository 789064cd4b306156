"""What families of devices share: options, polling, streaming, ramps in steps, serial lines. Standard library only."""
