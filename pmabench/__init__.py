"""pmabench: bench data acquisition and characterisation of pneumatic muscle actuators."""

__version__ = "0.1.0"
