"""Reading YAML files: places of every value, quantities with units, strict models, all problems at once."""
