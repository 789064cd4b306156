"""What formats share: `text_reader` reads rows of text, `times` reads their fields: numbers, and times of all kinds."""
