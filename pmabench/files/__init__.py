"""YAML that people write: places of every value, quantities with units, strict models, all problems at once."""
