"""What formats share: `text_reader` with `fields`, `times` of other programs, `matrices` that have a clock each."""
