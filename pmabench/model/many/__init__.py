"""Plants of several muscles: a joint of two with a pulley, and a platform on three, with parts of its control."""
