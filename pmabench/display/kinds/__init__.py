"""What one trial says by itself, by kind, as the analysis sorts them: `contraction`, `driven`, `loops`, `statics`."""
