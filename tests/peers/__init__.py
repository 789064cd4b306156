"""Programs of others against the emulators: what they read and decode is what the emulators hold and sent."""
