"""Plants of several muscles: two that pull on a pulley, three under a platform, with what controls that."""
