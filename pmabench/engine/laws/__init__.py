"""Laws of seeks: small state machines fed one sample at a time; standard library only."""
